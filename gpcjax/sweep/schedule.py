"""What one sweep's teacher offered as chances of advice, for the schedule of another (Table 5.4, iii and iv)."""

from pathlib import Path

from gpcjax.errors import UserError
from gpcjax.sweep.layout import tell
from gpcjax.sweep.runfolder import check_report


def offered_rates(out: Path) -> tuple[float, ...]:
    """Mean chance of advice in each episode of a finished sweep: mean over the steps of a run, then over runs.

    Under active learning a run's mean is taken over the steps whose coins allowed advice at all, the steps at which the
    chance was worked out: a fair sample, since the coins know nothing of the learner.

    Raises:
        UserError: `out` is no run folder, is not complete or no longer whole, or holds more than one setting.
    """
    check_report(out)
    import numpy as np

    from gpcjax.sweep.reading import read
    from gpcjax.sweep.rows import IDENTITY

    frame, _, manifest = read(out, tell)
    # A part that is lost or damaged would change the means, without a sign in them.
    first = frame[frame["episode"] == 1] if len(frame) else frame
    if not manifest["complete"] or len(first) < manifest["cells"]:
        raise UserError(f"{out}: this sweep is not complete, run it to its end first")
    for name in (*IDENTITY[1:-1], *manifest["varying"]):
        if len(set(frame[name].tolist())) > 1:
            raise UserError(f"{out}: its runs differ in {name}, give a sweep of one setting")
    table = frame.pivot(index="seed", columns="episode", values="chance").to_numpy()
    known = ~np.isnan(table)
    chances = np.where(known, table, 0.0).sum(0) / known.sum(0).clip(1)
    # An episode in which no coin of any run allowed advice has the chance of the one before, or of the first known.
    told = known.any(0)
    if not told.any():
        raise UserError(f"{out}: no chance of advice is known, its teacher never spoke")
    last = np.maximum.accumulate(np.where(told, np.arange(len(chances)), told.argmax()))
    return tuple(chances[last].tolist())
