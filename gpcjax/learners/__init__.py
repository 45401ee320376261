"""Learners: GPC, GPC-NS and COACH behind one interface."""
