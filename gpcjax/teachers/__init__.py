"""Teachers: who gives the advice."""
