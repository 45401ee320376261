"""Damaged folders are refused in one line that names the file, whatever was done to them."""

import gc
import json
import logging
import random
import re
import shutil
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

import gpcjax
from gpcjax.errors import Unwritten, UserError
from gpcjax.learners.factory import make_learner
from gpcjax.policies import checkpoint, folder
from gpcjax.policies.saved import load_policy, shipped_path


@pytest.fixture(scope="module")
def learner(tmp_path_factory):
    """A learner on disk, not to be changed: copy it."""
    path = tmp_path_factory.mktemp("learners") / "mine"
    learner = make_learner("coach", obs_size=2, action_size=1, lower=-1, upper=1, counts=(2, 3))
    gpcjax.save_learner(path, learner, learner.init())
    return path


def damage(path, draw, spared=()):
    """One change of one file, or of two; of none whose name is spared."""

    def files(path):
        return sorted(file for file in path.rglob("*") if file.is_file() and file.name not in spared)

    file = draw.choice(files(path))
    content = bytearray(file.read_bytes())
    match draw.choice(["flip", "cut", "add", "remove", "swap", "empty", "folder"]):
        case "flip" if content:
            content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
            file.write_bytes(content)
        case "cut" if content:
            file.write_bytes(content[: draw.randrange(len(content))])
        case "add":
            file.write_bytes(content + draw.randbytes(3))
        case "swap":
            other = draw.choice([each for each in files(path) if each.read_bytes() != content])
            file.write_bytes(other.read_bytes())
            other.write_bytes(content)
        case "folder":
            file.unlink()
            file.mkdir()
        case "empty" if content:
            file.write_bytes(b"")
        case _:
            file.unlink()


@pytest.mark.parametrize("what", ["learner", "shipped policy of format 1"])
def test_any_changed_byte_is_found(tmp_path, learner, what):
    source, load = (
        (learner, gpcjax.load_learner) if what == "learner" else (shipped_path("pendulum"), load_policy)
    )
    # Old policies may do without sums: only where they have them is every change found.
    draw, spared = random.Random(0), ("SHA256SUMS",) if "shipped" in what else ()
    for number in range(80):
        path = shutil.copytree(source, tmp_path / str(number))
        damage(path, draw, spared)
        with pytest.raises(ValueError, match=str(path)) as raised:
            load(path)
        assert "\n" not in str(raised.value)
        shutil.rmtree(path)


@pytest.mark.parametrize(
    "change", ["flip", *(pytest.param(change, marks=pytest.mark.slow) for change in ("cut", "remove"))]
)
def test_nothing_else_reaches_the_terminal(tmp_path, learner, change, capfd, caplog):
    """With sums that fit, so that the checkpoint itself is read; also nothing later, when what it left is freed."""
    path = shutil.copytree(learner, tmp_path / "bad")
    for file in sorted((path / "arrays").rglob("*")):
        if file.is_file() and file.parent.name == "d":
            content = file.read_bytes()
            match change:
                case "cut":
                    file.write_bytes(content[: len(content) // 2])
                case "flip":
                    file.write_bytes(bytes(byte ^ 255 for byte in content))
                case "remove":
                    file.unlink()
    sums = [f"{folder._sum(path / name)}  {name}\n" for name in folder._names(path)]
    (path / "SHA256SUMS").write_text("".join(sums))
    capfd.readouterr()
    with pytest.raises(
        UserError, match=rf"^{path}/arrays: the arrays of this learner cannot be read \(.+\)$"
    ) as raised:
        gpcjax.load_learner(path)
    assert raised.value.__context__ is None
    del raised
    gc.collect()
    assert capfd.readouterr() == ("", "") and not caplog.records
    assert logging.root.manager.disable == logging.NOTSET


@pytest.fixture
def at_most():
    """Lets no file of this process become larger, as a full disk does."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("size", [1, 300, 5000])
def test_arrays_that_do_not_fit_on_the_disk_are_one_line(tmp_path, at_most, size, capfd):
    """Orbax says so by a ValueError, a page long, and its threads complain of theirs afterwards."""
    arrays = {f"array{number}": np.random.default_rng(number).random(2000) for number in range(20)}
    at_most(size)
    with pytest.raises(UserError) as error:
        folder.write_folder(tmp_path / "mine", {}, arrays)
    assert (
        str(error.value)
        == f"{tmp_path / 'mine'}: it cannot be written there (File too large), give another path"
    )
    time.sleep(0.2)
    gc.collect()
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("arrays", "line"),
    [
        ({"a": np.ones(2), "b": np.zeros((0, 3))}, "b has no entries (shape (0, 3)), which cannot be saved"),
        ({"a": np.array(["x"])}, "a has entries of <U1, which cannot be saved: give numbers"),
        (
            {"a": np.zeros(2, [("x", float)])},
            "a has entries of [('x', '<f8')], which cannot be saved: give numbers",
        ),
        ({}, "there is no array with an entry to save"),
    ],
)
def test_arrays_without_a_form_are_no_fault_of_the_disk(tmp_path, arrays, line):
    with pytest.raises(UserError) as error:
        folder.write_folder(tmp_path / "mine", {}, arrays)
    assert str(error.value) == f"{tmp_path / 'mine'}: {line}"
    assert not list(tmp_path.iterdir())


def _raised(error, cause=None):
    """A checkpointer that fails."""

    class Failing:
        def __enter__(self):
            return self

        def __exit__(self, *exception):
            pass

        def save(self, *arguments):
            raise error from cause

    return Failing


@pytest.mark.parametrize(
    ("raised", "kind", "text"),
    [
        (_raised(RuntimeError("a fault")), RuntimeError, "a fault"),
        (_raised(MemoryError()), Unwritten, "(Cannot allocate memory), give another path"),
        (_raised(OSError(28, "")), Unwritten, "(No space left on device), give another path"),
        (_raised(ValueError("long"), OSError(28, "")), Unwritten, "(No space left on device)"),
        (_raised(ExceptionGroup("two", [ValueError("[os_error_code='28']")])), Unwritten, "(No space left"),
    ],
)
def test_only_what_the_system_refused_is_told_as_that(tmp_path, monkeypatch, raised, kind, text):
    monkeypatch.setattr(checkpoint, "_checkpointer", raised)
    with pytest.raises(kind, match=re.escape(text)) as error:
        folder.write_folder(tmp_path / "mine", {}, {"a": np.ones(1)})
    assert type(error.value) is kind and not list(tmp_path.iterdir())


def test_words_of_a_thread_that_nobody_hears_are_dropped_and_all_others_told(monkeypatch):
    heard = []
    monkeypatch.setattr(sys, "unraisablehook", lambda ignored: heard.append(str(ignored.exc_value)))
    for _ in range(2):
        checkpoint._drop_late_words()
    for text in ("Event loop is closed", "mine"):
        sys.unraisablehook(SimpleNamespace(exc_value=RuntimeError(text)))
    assert heard == ["mine"]


@pytest.mark.parametrize("place", ["file/new", "file/deep/new", "n" * 300, "/proc/none/new"])
def test_where_nothing_can_be_written_is_one_line(tmp_path, place, capfd):
    (tmp_path / "file").touch()
    learner = make_learner("coach", obs_size=1, action_size=1, lower=-1, upper=1, counts=(2,))
    for save in (gpcjax.save_learner, gpcjax.save_policy):
        path = tmp_path / place
        with pytest.raises(
            UserError, match=rf"^{path}: it cannot be written there \(.*\), give another path$"
        ):
            save(path, learner, learner.init())
        with pytest.raises(UserError, match=r"^path '': give a path$"):
            save("", learner, learner.init())
    assert capfd.readouterr() == ("", "") and [each.name for each in tmp_path.iterdir()] == ["file"]


STRANGE = [
    *(
        None,
        True,
        0,
        1,
        -1,
        7,
        7.0,
        0.5,
        1e308,
        float("inf"),
        float("nan"),
        10**30,
        2**28,
        "",
        "kernel",
        "x" * 1000,
    ),
    *([], {}, [1], [10**12], [[1]], [2**27, 2**27], {"points": []}, {"points": [1, 100, 3]}),
]


def edits(card, draw):
    """The card with one value changed, removed or added, at any depth."""
    card = json.loads(json.dumps(card))
    place = card
    while True:
        key = draw.choice(list(place) if isinstance(place, dict) else range(len(place)))
        inner = place[key]
        if isinstance(inner, dict | list) and inner and draw.random() < 0.7:
            place = inner
            continue
        if draw.random() < 0.25:
            del place[key]
        else:
            place[key] = draw.choice(STRANGE)
        return card


def test_an_edited_card_without_sums_acts_as_before_or_not_at_all(tmp_path):
    """Old policies have no sums: what says how to act must fit the arrays, or nothing is loaded."""
    path = shutil.copytree(shipped_path("pendulum"), tmp_path / "old")
    (path / "SHA256SUMS").unlink()
    card, draw = json.loads((path / "card.json").read_text()), random.Random(1)
    obs = np.array([0.5, 0.5, 0.3])
    before, refused = np.asarray(load_policy(path)(obs)), 0
    for _ in range(300):
        edited = edits(card, draw)
        (path / "card.json").write_text(json.dumps(edited))
        try:
            policy = load_policy(path)
        except ValueError as error:
            refused += 1
            assert str(path) in str(error) and "\n" not in str(error)
        else:
            # The two other closed forms fit the same arrays; nothing tells them apart without sums.
            if edited["smoothness"] == card["smoothness"]:
                np.testing.assert_array_equal(policy(obs), before)
    assert 20 < refused < 300


@pytest.mark.parametrize("smoothness", [7, 7.0, 1, True, "0.5", None, [0.5], float("nan"), 10**400])
def test_only_closed_forms(tmp_path, smoothness):
    path = shutil.copytree(shipped_path("pendulum"), tmp_path / "old")
    (path / "SHA256SUMS").unlink()
    card = json.loads((path / "card.json").read_text())
    (path / "card.json").write_text(json.dumps(card | {"smoothness": smoothness}))
    with pytest.raises(ValueError, match=rf"{path / 'card.json'}: this is not a policy's card \(smoothness"):
        load_policy(path)


def test_other_arrays_than_the_card_says(tmp_path):
    """Of two policies without sums the arrays are swapped: sizes differ, and a huge one is not made."""
    path = shutil.copytree(shipped_path("pendulum"), tmp_path / "old")
    (path / "SHA256SUMS").unlink()
    shutil.rmtree(path / "arrays")
    shutil.copytree(shipped_path("cartpole") / "arrays", path / "arrays")
    with pytest.raises(
        ValueError, match=rf"{path / 'arrays'}: .*cannot be read \(the card names arrays of shapes"
    ):
        load_policy(path)
    card = json.loads((path / "card.json").read_text())
    card["arrays"] = {"points": [1, 2**24, 3], "weights": [1, 2**24], "scale": [1, 3]}
    (path / "card.json").write_text(json.dumps(card))
    with pytest.raises(ValueError, match="the card names arrays of shapes"):
        load_policy(path)


def test_other_sizes_than_the_arrays_have(tmp_path):
    path = shutil.copytree(shipped_path("pendulum"), tmp_path / "old")
    (path / "SHA256SUMS").unlink()
    card = json.loads((path / "card.json").read_text())
    card["provenance"] |= {"obs_size": 4}
    (path / "card.json").write_text(json.dumps(card))
    with pytest.raises(ValueError, match=r"arrays of shapes .* are needed"):
        load_policy(path)
