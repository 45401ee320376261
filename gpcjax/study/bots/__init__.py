"""Scripted participants: `gpcjax study bots`, a rehearsal of a study over its own pages' protocol. Loads no jax."""
