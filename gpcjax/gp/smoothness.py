"""The smoothnesses nu of (3.4) for which a kernel has a closed form. Standard library only: files name them too."""

import math

SQUARED_EXPONENTIAL = math.inf
SMOOTHNESSES = (0.5, 1.5, 2.5, SQUARED_EXPONENTIAL)
