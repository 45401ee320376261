"""The rows of what a person taught, in the form of a sweep's: what reads those of oracles reads these.

A sweep has its number of episodes from the start; a person has not. So the folder's specification grows with each
episode: a new part and a new manifest are written, then the old part is removed.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gpcjax.learners.base import Status
from gpcjax.recording import CUT
from gpcjax.sweep import machine
from gpcjax.sweep.layout import CORRECTIONS, EPISODES, parse_part
from gpcjax.sweep.manifest import write_manifest
from gpcjax.sweep.opening import new_manifest
from gpcjax.sweep.plan import varying
from gpcjax.sweep.rows import CellRows
from gpcjax.sweep.store import Store
from gpcjax.teach.course import Course


def write_rows(
    folder: Path,
    course: Course,
    episodes: Mapping[str, np.ndarray],
    own: Mapping[str, np.ndarray],
    corrections: Mapping[str, np.ndarray],
) -> None:
    """Writes the rows of the finished episodes, in place of those before; nothing if there are none.

    Raises:
        OSError: they cannot be written.
    """
    count = len(episodes["returns"])
    if count == 0:
        return
    spec, cell = course.spec(count), course.cell(count)
    manifest = new_manifest(spec, varying(spec), 1)
    manifest |= {
        "baselines": {"idle": None, "oracles": dict.fromkeys(spec.oracle)},
        "env_steps": int(episodes["length"].sum()),
        "jobs": 1,
        "complete": True,
    }
    rows = CellRows(
        cell=cell,
        episode=np.arange(1, count + 1),
        status=[Status.OK.label if whole else CUT for whole in episodes["whole"]],
        episodes={name: values for name, values in episodes.items() if name != "whole"},
        corrections=dict(corrections),
        own=own,
    )
    store = Store(folder, manifest, machine.kind_of(manifest["machine"]))
    before = [part for name in (EPISODES, CORRECTIONS) for part in (folder / name).iterdir()]
    store.append([rows])
    write_manifest(folder, manifest)
    for part in before:
        if parse_part(part.name):
            part.unlink(missing_ok=True)
