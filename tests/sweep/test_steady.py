"""Readers of a folder that is asked for more, and puts parts together, after they have read its manifest."""

import numpy as np
import pytest

from gpcjax.sweep import parts, steady
from gpcjax.sweep import store as store_module
from gpcjax.sweep.chosen import Chosen, corrections_of
from gpcjax.sweep.counted import read_counted
from gpcjax.sweep.growth import grown
from gpcjax.sweep.layout import EPISODES
from gpcjax.sweep.listing import looked_into
from gpcjax.sweep.manifest import read_manifest, write_manifest
from gpcjax.sweep.parts import whole_parts
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read, read_corrections, read_kept
from gpcjax.sweep.sources import contents_of
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import Store
from tests.sweep.folders import begun
from tests.sweep.pretended import rows

SPEC = spec_of(env="cartpole", algo="gpc", seeds=8, episodes=3, oracle="lqr")
LATER = spec_of(env="cartpole", algo="gpc", seeds=8, episodes=3, oracle="lqr", human_length_scale=0.3)
"""The usual one is 0.2."""


@pytest.fixture
def out(tmp_path, monkeypatch):
    """A folder with a part for each cell."""
    monkeypatch.setattr(store_module, "TOGETHER", 100)
    store = Store(begun(tmp_path / "out", SPEC), read_manifest(tmp_path / "out"))
    for cell in plan(SPEC):
        store.append([rows(cell, kept=True)])
    return tmp_path / "out"


def grow(out, monkeypatch):
    """It is asked for more, and all is one part."""
    monkeypatch.setattr(store_module, "TOGETHER", 7)
    write_manifest(out, manifest := grown(read_manifest(out), LATER))
    store = Store(out, manifest, request=manifest["asked"][-1]["hash"])
    store.append([rows(cell, kept=True) for cell in store.missing(plan(LATER))])
    assert len(list((out / EPISODES).iterdir())) == 1


BEFORE, BETWEEN = "names_in", "part_of"
"""A reader has no names of parts yet, or has read two of them."""


@pytest.fixture(params=[pytest.param(BEFORE, marks=pytest.mark.slow), BETWEEN])
def growing(request, out, monkeypatch):
    """The folder is asked for more once its manifest was read, at one of two moments."""
    real, calls = getattr(parts, request.param), []

    def slowly(*arguments):
        calls.append(arguments)
        if len(calls) == (1 if request.param == BEFORE else 3):
            grow(out, monkeypatch)
        return real(*arguments)

    monkeypatch.setattr(parts, request.param, slowly)
    return out


def refuse(line):
    raise AssertionError(f"nothing was to be said, but: {line}")


@pytest.mark.parametrize("growing", [BEFORE, BETWEEN], indirect=True)
def test_rows(growing):
    found = read(growing, refuse)
    assert len(found.episodes) == 16 * 3 and len(found.corrections) == 16 * 2
    assert found.episodes["human_length_scale"].value_counts().to_dict() == {0.2: 24, 0.3: 24}
    assert found.manifest == read_manifest(growing)


def test_what_was_kept(growing):
    assert read_kept(growing, refuse)["human_length_scale"].value_counts().to_dict() == {0.2: 8, 0.3: 8}


def test_what_is_begun_with(growing):
    states = contents_of(growing, "--start", refuse).states
    assert sorted((state.values["seed"], state.values["human_length_scale"]) for state in states) == [
        (seed, value) for seed in range(8) for value in (0.2, 0.3)
    ]


def test_what_a_report_counts(growing):
    episodes, manifest = read_counted(growing, refuse)
    assert episodes is not None and len(episodes.seeds) == 16 and manifest == read_manifest(growing)


def test_corrections_of_runs_that_were_chosen_before(growing):
    """A setting that has begun to vary has the value that it had."""
    runs = Chosen("gpc", "lqr", 0.0, {}, np.arange(4))
    found = corrections_of(growing, read_before(growing), [runs])
    every = read_corrections(growing, refuse)
    wanted = every[(every["human_length_scale"] == 0.2) & (every["seed"] < 4)]
    assert sorted(found["seed"]) == sorted(wanted["seed"]) and len(found) == 4 * 2
    assert "human_length_scale" not in found.columns


def read_before(out):
    """The manifest, before anything is asked for."""
    manifest = read_manifest(out)
    assert "asked" not in manifest
    return manifest


def test_what_is_shown(growing):
    folder, held = looked_into(growing)
    assert held.finished == folder.cells == 16 and not held.foreign


def test_a_folder_that_grows_again_and_again(out, monkeypatch):
    """Each time it is read anew; what is not of it is told of in the end."""
    (out / EPISODES / "strange.parquet").write_bytes(b"")
    requests, read_parts, said = iter(("0.1", "0.2")), [], []

    def slowly(*arguments):
        read_parts.append(arguments)
        for error in requests:
            more = spec_of(env="cartpole", algo="gpc", seeds=8, episodes=3, oracle="lqr", error=float(error))
            write_manifest(out, grown(read_manifest(out), more))
            break
        yield from whole_parts(*arguments)

    monkeypatch.setattr("gpcjax.sweep.reading.whole_parts", slowly)
    assert len(read(out, said.append).manifest["asked"]) == 3 and len(read_parts) == 3
    assert len(said) == 1 and "strange.parquet" in said[0]


def test_a_manifest_that_is_known_is_not_read(out, monkeypatch):
    manifest = read_manifest(out)
    monkeypatch.setattr(steady, "read_manifest", lambda out: pytest.fail("it was read"))
    assert steady.steadily(out, lambda known, found: known["hash"], manifest)[:2] == (
        manifest["hash"],
        manifest,
    )
