"""What is taught in a benchmark: the same for all contenders. Loads nothing, so that a peer costs only itself."""

from dataclasses import dataclass, replace

ERRORS = (0.0, 0.1, 0.2, 0.3)
"""Of every case: equally many lanes have each chance of a wrong advice."""

EXPERT = {"cartpole": "lqr", "pendulum": "energy"}


@dataclass(frozen=True)
class Case:
    """One row of the comparison."""

    algo: str
    env: str
    episodes: int
    """Of every lane of every contender: equal work, from the idle policy to a learned one."""
    lanes: int = 128
    """Lanes of gpcjax for each error."""
    rate: float = 0.05
    delta: float = 0.05
    active_gain: float = 0.0
    """c_a of (3.6); then `rate` is the least chance gamma_c."""
    capacity: int | None = None
    """gpcjax in one block with room for so many points, whatever is needed; a full dictionary drops the rest."""

    @property
    def name(self) -> str:
        """Which of the three kinds of teaching it is."""
        if self.active_gain > 0:
            return "active"
        return "dense" if self.delta == 0 else "usual"


def cases(algos: tuple[str, ...], envs: tuple[str, ...]) -> list[Case]:
    """Usual teaching; advice at a tolerance of 0, where every chance ends in a correction; active learning."""
    chosen: list[Case] = []
    for env in envs:
        for algo in algos:
            usual = Case(algo, env, episodes={"cartpole": 7, "pendulum": 15}[env])
            few = {"cartpole": 5, "pendulum": 4}[env]
            chosen += [usual, replace(usual, delta=0.0, episodes=few, lanes=16)]
            if algo == "gpc":
                # On the pendulum advice is asked at half of the steps: scikit-learn's fits soon take minutes.
                active = {"cartpole": 5, "pendulum": 2}[env]
                chosen.append(replace(usual, rate=0.01, active_gain=1.0, episodes=active, lanes=32))
    return chosen
