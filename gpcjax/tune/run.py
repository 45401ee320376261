"""A search from Python: its settings by name, what it found as numbers and tables. Loads no jax before it runs."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpcjax.sweep.beginning import begun
from gpcjax.sweep.given import Given
from gpcjax.sweep.layout import MANIFEST
from gpcjax.sweep.spec import accepted_of
from gpcjax.tune import space
from gpcjax.tune.command import STATE, checked
from gpcjax.tune.flags import own_values

if TYPE_CHECKING:
    import pandas as pd

    from gpcjax.report.compare import Comparison


@dataclass(frozen=True)
class Tuned:
    """What a search found.

    | Field    | Meaning                                                                                    |
    |----------|--------------------------------------------------------------------------------------------|
    | `folder` | where all of it is: `best.toml`, `tune.html`, the rows of the search and of the check       |
    | `best`   | the settings that were found, for `run_sweep(**best, ...)`                                  |
    | `points` | a row for each point that was looked at on all seeds, the best first: its settings, `runs`, |
    |          | a column for each objective, `tied`, `front`; None of a fit                                 |
    | `check`  | runs with these settings and without them, on seeds that had no part in the choice, as      |
    |          | `gpcjax.compare` gives them; None where what was found is what was there                     |
    """

    folder: Path
    best: Mapping[str, Any]
    points: "pd.DataFrame | None"
    check: "Comparison | None"


def tune(
    search: Mapping[str, Any] | None = None,
    *,
    method: Any = None,
    objective: Any = None,
    trials: Any = None,
    batch: Any = None,
    rungs: Any = None,
    eta: Any = None,
    sampler_seed: Any = None,
    check_seeds: Any = None,
    runs: Any = None,
    take: Any = None,
    where: Mapping[str, Any] | None = None,
    jobs: Any = 1,
    **settings: Any,
) -> Tuned:
    """Searches hyperparameters, then judges the best of them on other seeds; `gpcjax tune` from Python.

    What `out` holds already is not done again, so an interrupted call goes on when it is made once more.

    Args:
        search: where to look, by the names of settings: "LOW:HIGH", "LOW:HIGH:linear", or a list of values.
        method: "tpe" (the default, which needs Optuna), "grid" or "mll".
        objective: "area" (the default), "final_return", "corrections" or "corrections_to_90"; several in a comma
            list for a Pareto front.
        trials: how many points of "tpe"; 100 by default.
        batch: how many of these at once; 16 by default.
        rungs: successive halving before all seeds and episodes, as "4x10,8".
        eta: one of so many points goes on to the next rung; 3 by default.
        sampler_seed: of the random numbers of "tpe"; 0 by default.
        check_seeds: on which the best is judged, none of the search's; 1000 to 1099 by default.
        runs: of "mll", the run folder with kept states that is fitted.
        take: of "mll", what becomes settings, in a comma list: "length_scale" (the default), "variance", "noise".
        where: of "mll", columns of these runs and the value that is wanted of each.
        jobs: processes at once.
        **settings: those of a sweep as in `run_sweep`, with one value for each hyperparameter; `out`, the folder.

    Raises:
        UserError: a setting that is not allowed, or a folder that holds something else (a ValueError).
        Failure: a worker failed; what was finished is kept.
    """
    mine = {
        "method": method,
        "objective": objective,
        "trials": trials,
        "batch": batch,
        "rungs": rungs,
        "eta": eta,
        "sampler_seed": sampler_seed,
        "check_seeds": check_seeds,
        "runs": None if runs is None else os.fspath(runs),
        "take": take,
    }
    own = own_values({}, {name: value for name, value in mine.items() if value is not None}, "")
    look = Given(space.of_table(search or {}, "search "), "search")
    which = {name: str(value) for name, value in (where or {}).items()}
    wishes = checked(own, look, accepted_of({**settings, "jobs": jobs}, ""), which, 1)
    from gpcjax.tune.carrying_out import carried_out

    with begun(wishes.out, (MANIFEST, STATE)):
        result = carried_out(wishes)
    outcome = result.outcome
    return Tuned(wishes.out, outcome.told["best"], outcome.points, result.check)
