"""Experiments as data: specification, plan, run, store."""
