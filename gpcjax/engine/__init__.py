"""The batched loop that teaches many lanes at once."""
