"""The experiment of docs/tuning.md: pairs of runs, and what becomes of the numbers that are kept."""

import numpy as np
import pytest

from docs import tuning_experiment as experiment
from gpcjax.report.statistics import Interval
from gpcjax.sweep.manifest import write_manifest
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import Store
from tests.sweep.folders import begun, manifest_of
from tests.sweep.pretended import rows


def held(folder, seeds, more):
    """A complete run folder whose returns are the seed's, and `more`."""
    spec = spec_of(env="pendulum", algo="gpc", error=0.1, seeds=seeds, episodes=6)
    store = Store(begun(folder, spec), manifest_of(spec))
    store.missing([])
    for cell in plan(spec):
        made = rows(cell, episodes=6)
        made.episodes["returns"] = made.episodes["returns"] + more * np.arange(6.0)
        store.append([made])
    write_manifest(folder, manifest_of(spec) | {"complete": True})


def test_tuned_and_before_are_compared_seed_by_seed(tmp_path):
    assert experiment.compared(tmp_path) == []
    held(tmp_path / "pendulum-gpc-before", 6, 0.0)
    held(tmp_path / "pendulum-gpc-length-scales", 4, 1.0)
    (row,) = experiment.compared(tmp_path)
    assert (row.task, row.label, row.pairs) == ("pendulum", "GPC: length-scales", 4)
    assert row.area.estimate == pytest.approx(2.5) and row.final.estimate == pytest.approx(3.0)


def test_new_numbers_take_the_place_of_old_ones(tmp_path):
    file = tmp_path / "kept.csv"
    file.write_text(experiment.RECORDED.read_text())
    old = experiment.recorded([], file)
    assert file.read_text() == experiment.RECORDED.read_text()  # without new ones nothing changes
    new = experiment.Row(
        "pendulum", "GPC: length-scales", Interval(1.0, 0.5, 1.5), Interval(2.0, -1.0, 5.0), 100
    )
    other = new._replace(label="GPC-NS: all")
    found = experiment.recorded([new, other], file)
    assert [row for row in found if row.task != "pendulum"] == [row for row in old if row.task != "pendulum"]
    assert new in found and other in found and found == experiment.recorded([], file)
    assert (
        "| Pendulum | GPC: length-scales | 1.00 [0.50, 1.50] | 2.00 [-1.00, 5.00] | 100 |"
        in experiment.table(found)
    )


def test_each_case_has_folders_and_labels_of_its_own():
    cases = experiment.cases()
    labels = [(case.task, case.label(take)) for case in cases for take in case.takes]
    assert len({case.name for case in cases}) == len(cases) and len(set(labels)) == len(labels)
    assert {case.task for case in cases} == {"cartpole", "mountaincar", "pendulum", "lunarlander"}
    for case in cases:
        spec_of(**case.settings, seeds=case.seeds)
