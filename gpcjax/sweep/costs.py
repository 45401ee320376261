"""About what programs take of one core: the one table for guesses of time. Loads no jax.

Measured on a core of an AMD EPYC (`benchmarks/README.md`). Only ratios matter as soon as one program has been seen, for
that tells how fast this machine is.
"""

_EPISODE = {
    ("cartpole", "gpc"): 4e-4,
    ("cartpole", "gpc-ns"): 8e-4,
    ("cartpole", "coach"): 1e-4,
    ("pendulum", "gpc"): 1.2e-4,
    ("pendulum", "gpc-ns"): 6.3e-4,
    ("pendulum", "coach"): 3.3e-5,
    ("lunarlander", "gpc"): 1.3e-2,
    ("lunarlander", "gpc-ns"): 2.2e-1,
    ("lunarlander", "coach"): 7e-3,
}
"""Seconds of an episode, with an expert whose target costs no more than a step."""

_TARGETS = {("cartpole", "mpc"): 3.4, ("pendulum", "mpc"): 0.22}
"""Seconds that the targets of an episode take beside, of experts that plan: 27 and 22 ms each, at 5 % of the steps of a
full episode, where a teacher may advise."""

COMPILING = {"gpc": 7.0, "gpc-ns": 11.0, "coach": 1.6}
"""Seconds until a learner's program is compiled."""


def of_episode(env: str, algo: str, oracle: str) -> float:
    """Seconds of an episode of this program, without compiling it."""
    return _EPISODE[env, algo] + _TARGETS.get((env, oracle), 0.0)
