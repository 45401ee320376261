"""Gaussian processes over fixed-capacity dictionaries: arrays only."""
