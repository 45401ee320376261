"""Tasks to teach and the experts that master them."""
