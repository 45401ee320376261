"""Turns on float64 in jax: imported first by every base module that computes (DESIGN: float32 is not enough here)."""

import jax

jax.config.update("jax_enable_x64", True)
