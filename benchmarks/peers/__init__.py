"""The two loops that gpcjax is timed against: scikit-learn, and numpy as fast as a Python loop gets."""
