"""All that a sweep and its folder have to survive.

    python -m tests.torture [--cases 1000] [--kills 200] [--disks 400] [--seed 0]

Folders are spoiled (`folders`), checkpoints (`underway`) and shards (`shards`); disks become full or read-only under a
command, or its folder goes (`disks`; `disks_saving` saves, `disks_underway` has real workers); real sweeps are
killed at random moments (`kills`).
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.sweep.test_underway import COMPILED, KEEP, killed_under_way
from tests.torture import folders, kills, shards, underway
from tests.torture.telling import told


def main() -> int:
    """Says how many cases became what, and prints those that were not right."""
    parser = argparse.ArgumentParser(
        description="Spoil run folders, disks and sweeps, and see that nothing is lost."
    )
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--disks", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    cases, seed = arguments.cases, arguments.seed
    wrong = told("spoiled folders", folders.torture(cases, seed))
    wrong += told("spoiled folders without checksums", folders.torture(cases, seed, sealed=False))
    wrong += told("spoiled shards", shards.torture(cases, seed))
    with tempfile.TemporaryDirectory() as folder:
        out = killed_under_way(Path(folder), COMPILED | KEEP)
        wrong += told("spoiled checkpoints", underway.torture(out, cases, seed))
    disks = {
        "disks": arguments.disks,
        "disks_saving": arguments.disks,
        "disks_underway": arguments.disks // 20,
    }
    for module, some in disks.items():
        # In a process of its own, which mounts disks that nobody else sees.
        words = ["-m", f"tests.torture.{module}", "--cases", str(some), "--seed", str(seed)]
        wrong += subprocess.run([sys.executable, *words]).returncode
    killed = list(kills.torture(arguments.kills, seed))
    print("\n".join(killed) if killed else "no kill did any harm")
    return os.EX_OK if not wrong and not killed else 1


if __name__ == "__main__":
    sys.exit(main())
