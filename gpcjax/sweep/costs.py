"""About what programs take of one core: the one table for guesses of time. Loads no jax.

A sweep corrects them as soon as one program has been seen, which tells how fast this machine is; until then, and for an
experiment that has not begun, they are all that is known.
"""

_EPISODE = {
    ("cartpole", "gpc"): 4.5e-4,
    ("cartpole", "gpc-ns"): 8e-4,
    ("cartpole", "coach"): 1.3e-4,
    ("pendulum", "gpc"): 3.3e-4,
    ("pendulum", "gpc-ns"): 1.6e-3,
    ("pendulum", "coach"): 8.5e-5,
    ("pendulum", "d-coach"): 1.2e-2,
    ("lunarlander", "gpc"): 1.2e-2,
    ("lunarlander", "gpc-ns"): 2e-1,
    ("lunarlander", "coach"): 6e-3,
    ("mountaincar", "gpc"): 3.4e-4,
    ("mountaincar", "gpc-ns"): 1.6e-3,
    ("mountaincar", "coach"): 7e-5,
}
"""Seconds of an episode, with an expert whose target costs no more than a step: of sweeps of some hundred runs, with
the usual settings (`python -m benchmarks.progress`), on a machine that needs 1.3 s of a core to start a worker. The
lander's are those of its experiment in docs/reproduction."""

_TARGETS = {("cartpole", "mpc"): 0.05, ("pendulum", "mpc"): 0.016}
"""Seconds that the targets of an episode take beside, of experts that plan: 0.8 and 1.6 ms each, at 5 % of the steps of
a usual episode (1,100 and 200), where a teacher may advise."""

_COMPILING = {"gpc": 5.0, "gpc-ns": 7.5, "coach": 2.8, "d-coach": 12.0}
"""Seconds until the programs of the first tier are compiled."""

_FURTHER = {"gpc-ns": 0.5}
"""Part of them that those of a further tier take, where it is not all: 22 of 37, 12 of 35 and 49 of 106 s were seen."""

_TIERS = {"gpc": 2}
"""Tiers that runs with the usual settings get to, of learners with a dictionary."""

LANES = 64
"""Of a block: a sweep of so few cells keeps it full for half of its time."""

_EPISODES_OF_FIRST = 5
"""In so few episodes hardly a dictionary outgrows the first tier."""

_EPISODE_OF_OTHERS, _COMPILING_OTHERS = 1e-3, 5.0
"""Of a task or a learner that is not in the tables: a guess that holds until it has been seen."""


def of_episode(env: str, algo: str, oracle: str) -> float:
    """Seconds of an episode of this program, without compiling it."""
    return _EPISODE.get((env, algo), _EPISODE_OF_OTHERS) + _TARGETS.get((env, oracle), 0.0)


def compiling(algo: str, tiers: int = 1) -> float:
    """Seconds until a learner's programs of so many tiers are compiled."""
    return _COMPILING.get(algo, _COMPILING_OTHERS) + (tiers - 1) * further(algo)


def further(algo: str) -> float:
    """Seconds until those of one more tier are."""
    return _FURTHER.get(algo, 1.0) * _COMPILING.get(algo, _COMPILING_OTHERS)


def tiers(algo: str, episodes: int) -> int:
    """How many tiers of dictionaries runs of so many episodes usually get to: each is compiled when a run does."""
    return _TIERS.get(algo, 1) if episodes > _EPISODES_OF_FIRST else 1
