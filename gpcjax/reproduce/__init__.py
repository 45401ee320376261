"""The thesis' illustrative figures, computed and drawn anew."""
