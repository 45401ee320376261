"""Folders of arrays on a disk with any number of bytes left: checkpoints, policies and learners.

    python -m tests.torture.disks_saving [--cases 60] [--seed 0]

Right is: the folder is whole, or there is one line that says why, and nothing is left behind; never another exception,
and no word of orbax's or tensorstore's.
"""

import argparse
import contextlib
import os
import sys
import tempfile
import time
import traceback
from pathlib import Path

import numpy as np

from gpcjax.errors import UserError
from gpcjax.policies.folder import read_arrays, read_card, write_folder
from tests.torture.disk import Disk, count, in_private

KIND = "checkpoint"


def torture(cases: int, seed: int):
    """What happened in each case, what became of it (None: it was not right), and why."""
    random = np.random.default_rng(seed)
    arrays = {
        f"{name}": random.normal(size=size)
        for name, size in zip("abcdefgh", (1, 9, 50_000, 300, 20_000, 4, 5, 6), strict=True)
    }
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        disk = Disk(Path(folder, "disk"), "8m")
        stack.callback(disk.close)
        if not disk.mounted:
            return
        out = disk.path / "out"
        out.mkdir()
        before = _used(disk)
        write_folder(out / "whole", {"kind": KIND}, arrays)
        size = _used(disk) - before
        for number in range(cases):
            left = 2 * size * number // cases // 4096 * 4096
            path = out / f"{number}"
            disk.faults["full"](out, left)
            try:
                yield f"{left:,} of {size:,} bytes", _judged(path, arrays), ""
            except Exception:
                yield f"{left:,} of {size:,} bytes", None, traceback.format_exc()
            finally:
                disk.mend("full", out)


def _used(disk: Disk) -> int:
    stat = os.statvfs(disk.path)
    return (stat.f_blocks - stat.f_bfree) * stat.f_frsize


def _judged(path: Path, arrays) -> str:
    try:
        write_folder(path, {"kind": KIND}, arrays)
    except UserError as error:
        assert "No space left on device" in str(error), error
        assert "\n" not in str(error) and len(str(error)) < 300, error
        time.sleep(0.2)
        assert [each.name for each in path.parent.iterdir()] == ["whole"]
        return "refused"
    found = read_arrays(path, read_card(path, KIND), KIND)
    assert all(np.array_equal(found[name], value) for name, value in arrays.items())
    for each in sorted(path.rglob("*"), reverse=True):
        each.rmdir() if each.is_dir() else each.unlink()
    path.rmdir()
    return "written"


def main() -> int:
    """Says how many cases became what, and prints those that were not right."""
    parser = argparse.ArgumentParser(description="Save where a disk is nearly full.")
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    in_private("tests.torture.disks_saving")
    return count("saved on full disks", torture(arguments.cases, arguments.seed))


if __name__ == "__main__":
    sys.exit(main())
