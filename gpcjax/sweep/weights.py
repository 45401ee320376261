"""What the cells of a program weigh when a sweep is cut into shares. Loads no jax.

These numbers decide which cells a shard has, so they are part of the format of run folders: shards of the same n fit
together only as long as nobody changes them. They were seconds of a core once (0.2.0); what programs take today is in
`gpcjax.sweep.costs`, which is for telling the time alone.
"""

_EPISODE = {
    ("cartpole", "gpc"): 1.5e-3,
    ("cartpole", "gpc-ns"): 3e-3,
    ("cartpole", "coach"): 3.8e-4,
    ("pendulum", "gpc"): 7.7e-4,
    ("pendulum", "gpc-ns"): 4e-3,
    ("pendulum", "coach"): 2.1e-4,
    ("lunarlander", "gpc"): 1.3e-2,
    ("lunarlander", "gpc-ns"): 2.2e-1,
    ("lunarlander", "coach"): 7e-3,
    ("mountaincar", "gpc"): 9e-4,
    ("mountaincar", "gpc-ns"): 5e-3,
    ("mountaincar", "coach"): 3e-4,
}
_EPISODE_OF_OTHERS = 1e-3

_TARGETS = {("cartpole", "mpc"): 0.05, ("pendulum", "mpc"): 0.016}
"""More for an episode, with an expert that plans."""

_FIRST = {"gpc": 7.0, "gpc-ns": 11.0, "coach": 1.6, "d-coach": 20.0}
_FIRST_OF_OTHERS = 5.0


def of_episode(env: str, algo: str, oracle: str) -> float:
    """Of an episode of a cell."""
    return _EPISODE.get((env, algo), _EPISODE_OF_OTHERS) + _TARGETS.get((env, oracle), 0.0)


def of_program(algo: str) -> float:
    """Of a program in each share that has some of its cells."""
    return _FIRST.get(algo, _FIRST_OF_OTHERS)
