"""What sweeps and their folders have to survive: `python -m tests.torture` is all, `tests/test_torture.py` a sample."""
