"""Tables, statistics and figures from a finished store."""
