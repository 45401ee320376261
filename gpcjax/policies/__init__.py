"""Policies as data: what a learner's state says about acting, ready for many steps, saved and loaded."""
