"""Watching a policy: in a window, or as an animated GIF."""
