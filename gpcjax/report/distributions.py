"""Quantiles and tails of the distributions behind intervals and tests.

The same functions as in scipy.stats, to the bit, from scipy.special alone: the former takes longer to import than a
report takes to compute.
"""

import numpy as np
from jaxtyping import Float
from scipy import special

Numbers = Float[np.ndarray, "*shape"] | float | int


def student_quantile(p: Numbers, freedom: Numbers) -> Float[np.ndarray, "*shape"]:
    """Where Student's t with so many degrees of freedom has the probability `p` below."""
    return special.stdtrit(freedom, p)


def student_tail(value: float, freedom: float) -> float:
    """The probability of Student's t above `value`."""
    return float(special.stdtr(freedom, -value))


def fair_binomial_quantile(p: float, n: Numbers) -> Float[np.ndarray, "*shape"]:
    """The least number of successes in `n` even chances (0 or more) that has at least the probability `p` up to it."""
    some = np.maximum(n, 1)
    nearest = np.ceil(special.bdtrik(p, some, 0.5))
    below = np.maximum(nearest - 1, 0)
    return np.where(np.asarray(n) == 0, 0.0, np.where(special.bdtr(below, some, 0.5) >= p, below, nearest))


def beta_quantile(
    p: float, first: Float[np.ndarray, "n"], second: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Where the beta distribution of these parameters has the probability `p` below."""
    return special.betaincinv(first, second, p)
