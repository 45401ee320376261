"""What the runs of a folder had learned, as policies and as states to go on teaching with."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from gpcjax.allowed import checked_path
from gpcjax.errors import UserError
from gpcjax.learners.packed import unpack_learner
from gpcjax.policies.saved import Unfit, unpack_policy
from gpcjax.sweep.kept import PACKED, Kind, kept_rows
from gpcjax.sweep.packing import unpacked
from gpcjax.sweep.runfolder import check_report


def load_policies(out: Any, /, **where: Any) -> pd.DataFrame:
    """The policies that a sweep kept (`--keep policies`, or those of `--keep states`), a row for each.

    Args:
        out: the run folder.
        **where: columns and the values that are wanted, one or several: `seed=3`, `algo=["gpc", "coach"]`.

    | column | type | what |
    |---|---|---|
    | env, algo, oracle, error, seed | | the run, as in `load` |
    | delta, rate, ... | float | each setting with several values |
    | episode | int | after which it was kept, from 1 |
    | return | float | of that episode, while it was taught |
    | policy | Policy | obs (obs_size,) -> action (action_size,) in [-1, 1] |

    Raises:
        ValueError: `out` is no run folder, nothing was kept there, no column is called so, or what was kept is damaged.
    """
    return _loaded(out, "policy", where, {"policy": lambda made: made})


def load_states(out: Any, /, **where: Any) -> pd.DataFrame:
    """What learners had learned in a sweep (`--keep states`), a row for each: teaching goes on from there.

    As `load_policies`; in the place of `policy` are `learner` and `state`, as `gpcjax.load_learner` gives them. A
    dictionary has room for as many points again as it holds. A learner of one's own is made by its module, which must
    be found.

    Args:
        out, **where: as `load_policies` takes them.

    Raises:
        ValueError: as `load_policies`.
    """
    return _loaded(out, "state", where, {"learner": lambda made: made[0], "state": lambda made: made[1]})


def _loaded(
    out: Any, kind: Kind, where: dict[str, Any], columns: dict[str, Callable[[Any], Any]]
) -> pd.DataFrame:
    folder = checked_path("out", out)
    check_report(folder)
    wanted = kept_rows(folder, kind, where)
    found = [learned_of(folder, kind, row) for row in wanted.to_dict("records")]
    made = {
        name: pd.Series([make(each) for each in found], wanted.index, object)
        for name, make in columns.items()
    }
    names = [name for name in wanted.columns if name not in PACKED]
    return wanted.loc[:, names].assign(**made).reset_index(drop=True)


def learned_of(folder: Path, wanted: Kind, row: Mapping[str, Any], grown: bool = True) -> Any:
    """The policy, or the learner and its state, of a row of `kept_rows`; a state is `grown` to go on with.

    Raises:
        UserError: it is damaged.
    """
    source = f"{folder}: what {row['algo']} learned with seed {row['seed']}"
    try:
        told, named = unpacked(row["card"], row["arrays"])
        if row["kind"] == "policy":
            return unpack_policy(told, named)
        learner, state = unpack_learner(told, named, source)
    except (Unfit, KeyError, TypeError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{source} is damaged ({error})") from None
    if wanted == "policy":
        return learner.policy_of(state)
    return learner, learner.grow(state) if grown else state
