"""All that is checked of a sweep before anything is written. Loads no jax, but for learners of one's own."""

from pathlib import Path

from gpcjax.sweep.keepable import check_keeping, check_kept
from gpcjax.sweep.keeping import Keeping
from gpcjax.sweep.plan import count
from gpcjax.sweep.runfolder import check_sweep
from gpcjax.sweep.shards import Shard, check_shard
from gpcjax.sweep.spec import SweepSpec


def check(
    out: Path,
    spec: SweepSpec,
    keeping: Keeping | None,
    shard: Shard | None,
    keep: str = "keep",
    start: str = "start",
    resolved: bool = True,
) -> None:
    """Refuses what cannot run, or not in this folder.

    Args:
        out: the run folder, that of the share where there is a `shard`.
        spec: what is asked for.
        keeping: what is kept of the runs.
        shard: the share that is asked for.
        keep, start: what messages call these two settings.
        resolved: whether `spec` is whole; without its schedule it is not the one that the folder holds.

    Raises:
        UserError: it cannot.
    """
    check_keeping(keeping, spec, keep)
    if resolved:
        check_folder(out, spec, keeping, shard)
    if spec.start is not None:
        from gpcjax.sweep.startable import check_start  # which reads run folders

        check_start(spec, start)


def check_folder(
    out: Path, spec: SweepSpec, keeping: Keeping | None, shard: Shard | None, grows: bool = True
) -> None:
    """Refuses a folder that holds something else, or keeps something else of its runs.

    Raises:
        UserError: it is such a folder.
    """
    check_sweep(out, spec, grows)
    check_shard(out, shard, count(spec))
    check_kept(out, keeping, spec)
