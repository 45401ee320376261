"""What a report reads of a run folder: the same as the frames have."""

import shutil

import numpy as np
import pandas as pd
import pytest

from gpcjax.errors import UserError
from gpcjax.report.groups import gather
from gpcjax.sweep.chosen import Chosen, corrections_of
from gpcjax.sweep.coded import joint
from gpcjax.sweep.counted import Episodes, read_counted
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read, read_corrections, read_episodes
from gpcjax.sweep.requested import chosen_of
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import Store
from tests.report import synthetic
from tests.sweep.folders import begun
from tests.sweep.pretended import rows
from tests.torture import folders

FIRST = {
    "env": "cartpole",
    "algo": ["gpc", "coach"],
    "error": 0.1,
    "seeds": 3,
    "episodes": 3,
    "oracle": "lqr",
}


def grown(out):
    """Cells of three requests, with other seeds for each point and a setting that varies since the second."""
    from gpcjax.sweep.growth import grown as grown_manifest
    from gpcjax.sweep.manifest import write_manifest

    asked = [
        FIRST,
        FIRST | {"seeds": "2-5", "policy_variance": [0.1, 0.2], "algo": "gpc"},
        FIRST | {"error": 0.3, "rate": 0.5, "seeds": "7-8"},
    ]
    begun(out, spec_of(**asked[0]))
    for place, request in enumerate(asked):
        spec = spec_of(**request)
        if place:
            write_manifest(out, grown_manifest(read_manifest(out), spec))
        manifest = read_manifest(out)
        asked_now = manifest.get("asked") or [{"hash": manifest["hash"]}]
        store = Store(out, manifest, request=asked_now[-1]["hash"])
        missing = store.missing(plan(spec))
        for cell in missing:  # two cells a part at most, so that groups lie in several
            store.append([rows(cell, status="full" if cell.seed == 4 else "ok")])
    return out


def flat(study):
    """All that the groups of a study hold."""
    return [
        (g.oracle, g.error, g.algo, g.point, g.stopped, g.unfinished, g.limits, g.seeds.tolist(),
         g.returns.tolist(), g.corrections.tolist())
        for g in study.groups
    ]  # fmt: skip


def same_study(out):
    """Whether the arrays of a folder make the study that its frame makes; how many groups it has."""
    counted, manifest = read_counted(out, lambda line: None)
    every = read(out, lambda line: None)
    assert manifest == every.manifest
    ours, theirs = gather(counted, manifest), gather(every.episodes, every.manifest)
    assert flat(ours) == flat(theirs) and ours.varying == theirs.varying and ours.env == theirs.env
    return len(ours.groups)


def test_a_grown_folder_has_the_study_of_its_frame(tmp_path):
    assert same_study(grown(tmp_path)) == 6
    counted, manifest = read_counted(tmp_path, lambda line: None)
    study = gather(counted, manifest)
    assert len(counted.seeds) == manifest["cells"] == len(read_episodes(tmp_path)) / 3
    assert {len(group.seeds) for group in study.groups} > {2} and len(counted.cell) == 3 * len(counted.seeds)


def test_a_folder_of_format_2_too(tmp_path):
    points = synthetic.length_scale_grid((0.1, 0.2), (0.1, 0.2))
    frame = synthetic.episodes(points=points, errors=(0.0, 0.2), seeds=4, length=3)
    corrections = synthetic.corrections(points=points, errors=(0.0, 0.2), seeds=4)
    synthetic.write(tmp_path, frame, corrections, synthetic.manifest(frame, list(points["gpc"][0])))
    assert same_study(tmp_path) == 2 * (4 + 4 + 1)


def test_cells_that_are_there_twice_count_once(tmp_path):
    spec = spec_of(**FIRST)
    for name, seeds in (("one", (0, 1)), ("two", (1, 2))):
        out = begun(tmp_path / name, spec)
        cells = [cell for cell in plan(spec) if cell.seed in seeds]
        Store(out, read_manifest(out)).append([rows(cell) for cell in cells])
    for folder in ("episodes", "corrections"):
        for path in (tmp_path / "two" / folder).iterdir():
            shutil.copy(path, tmp_path / "one" / folder / path.name.replace("part-00000", "part-00001"))
    said = []
    counted, _ = read_counted(tmp_path / "one", said.append)
    assert "2 cells are there twice" in said[0] and len(said) == 1
    assert len(counted.seeds) == 6 and len(counted.cell) == 18
    assert same_study(tmp_path / "one") == 2
    (group, _) = gather(counted, read_manifest(tmp_path / "one")).groups
    chosen = Chosen(group.algo, group.oracle, group.error, {}, group.seeds)
    assert len(corrections_of(tmp_path / "one", read_manifest(tmp_path / "one"), [chosen])) == 6


def test_damaged_parts_and_empty_folders(tmp_path):
    spec = spec_of(**FIRST)
    out = begun(tmp_path, spec)
    store = Store(out, read_manifest(out))
    assert read_counted(out, lambda line: None)[0] is None
    for cell in plan(spec)[:2]:
        store.append([rows(cell)])
    first, second = sorted((out / "episodes").iterdir())
    first.write_bytes(first.read_bytes()[:-9])
    said = []
    counted, _ = read_counted(out, said.append)
    assert len(counted.seeds) == 1 and "1 damaged part left out" in said[0]
    second.write_bytes(b"")
    with pytest.raises(UserError, match="none of its rows is whole"):
        read_counted(out, said.append)


def test_the_corrections_of_some_runs_are_those_of_the_frame(tmp_path):
    grown(tmp_path)
    manifest, every = read_manifest(tmp_path), read_corrections(tmp_path)
    chosen = [
        Chosen("gpc", "lqr", 0.1, {"policy_variance": 0.2, "rate": 0.05}, np.array([2, 5])),
        Chosen("coach", "lqr", 0.3, {"rate": 0.5}, np.array([8])),
        Chosen("coach", "lqr", 0.1, {"rate": 0.5}, np.array([0, 1])),
    ]
    found = corrections_of(tmp_path, manifest, chosen)
    wanted = every[
        ((every["algo"] == "gpc") & (every["policy_variance"] == 0.2) & every["seed"].isin([2, 5]))
        | ((every["algo"] == "coach") & (every["error"] == 0.3) & (every["seed"] == 8))
    ]
    keys = ["algo", "error", "seed", "episode", "step"]
    left, right = (frame.sort_values(keys).reset_index(drop=True) for frame in (found, wanted[found.columns]))
    pd.testing.assert_frame_equal(left, right)
    assert len(found) == 6 and corrections_of(tmp_path, manifest, []).empty
    skipped = read_counted(tmp_path, lambda line: None)[0].places.without(chosen)
    pd.testing.assert_frame_equal(corrections_of(tmp_path, manifest, chosen, skipped), found)


def test_parts_without_a_chosen_run_are_not_opened(tmp_path):
    spec = spec_of(**FIRST)
    out = begun(tmp_path, spec)
    store = Store(out, read_manifest(out))
    cells = plan(spec)
    for cell in cells:
        store.append([rows(cell)])
    counted, manifest = read_counted(out, lambda line: None)
    chosen = [Chosen("coach", "lqr", 0.1, {}, np.array([1, 2]))]
    skip = counted.places.without(chosen)
    assert len(skip) == len(cells) - 2
    before = corrections_of(out, manifest, chosen)
    for name in skip:
        (out / "corrections" / name).write_bytes(b"")
        (out / "episodes" / name).write_bytes(b"")
    pd.testing.assert_frame_equal(corrections_of(out, manifest, chosen, skip), before)
    assert len(before) == 4
    of_a_frame = Episodes.of(synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=2, length=3), [])
    assert of_a_frame.places.without(chosen) == set()


@pytest.mark.parametrize("largest", [3, 1 << 40])
def test_a_number_for_each_combination(largest):
    """Of more combinations than a number has, too."""
    random = np.random.default_rng(4)
    columns = [random.integers(-1, 3, 200) for _ in range(4)] + [
        random.integers(0, 2, 200) * (largest - 1)
    ] * 2
    numbers = joint(columns)
    told = {}
    for number, row in zip(
        numbers.tolist(), zip(*(column.tolist() for column in columns), strict=True), strict=True
    ):
        assert told.setdefault(row, number) == number
    assert len(set(told.values())) == len(told)


def test_cells_whose_rows_are_scattered_are_found():
    frame = synthetic.episodes(algos=("gpc", "coach"), errors=(0.0,), seeds=3, length=4)
    shuffled = Episodes.of(frame.sample(frac=1, random_state=2), [])
    assert len(shuffled.seeds) == 6 and np.bincount(shuffled.cell).tolist() == [4] * 6
    steps = frame.groupby(["algo", "seed"])["length"].sum()
    assert shuffled.totals["length"].tolist() == steps.tolist()


@pytest.mark.parametrize("spec", [folders.FIRST, folders.SPEC], ids=["the first", "the later one"])
def test_what_was_asked_for_alone_of_a_folder_that_grew(tmp_path, spec):
    out = folders.finished(tmp_path / "out", folders.SPEC, folders.FIRST)
    episodes, manifest = read_counted(out, lambda line: None)
    mine, told = chosen_of(episodes, manifest, spec)
    alone, _ = read_counted(folders.finished(tmp_path / "alone", spec), lambda line: None)
    assert len(mine.seeds) == len(alone.seeds) == told["cells"] == len(plan(spec))
    assert sorted(mine.returns) == sorted(alone.returns) and "asked" not in told
    assert list(mine.settings) == list(alone.settings) and set(mine.seeds) == set(alone.seeds)
