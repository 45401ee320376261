"""What is there before a page's commands are typed, and what has to be there after them."""

import re
import shutil
from pathlib import Path

from PIL import Image

from gpcjax.policies.saved import shipped_path
from gpcjax.sweep.layout import MANIFEST
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import sweep
from gpcjax.teachers.replay import read_advice
from tests.docs.pages import ROOT, blocks
from tests.report.test_compare import folder as study
from tests.sweep.pretended import Pretended


def _before_comparing(everything):
    for name, given in (("narrow", 0.1), ("wide", 0.4)):
        study(Path("runs", name), given={"policy_length_scale": given})


def _before_stores(everything):
    """The rows that its first block asks for are there, unless all is run: docs/python.md computes such ones."""
    if not everything:
        given = {
            "env": "cartpole",
            "algo": "coach",
            "error": [0, 0.2],
            "seeds": 4,
            "episodes": 6,
            "oracle": "lqr",
        }
        sweep("runs/small", executor=Pretended()(1), **given)


def _after_stores(names, everything):
    """By its first block nothing was computed that was not asked for."""
    assert len(names["frame"]) == len(names["episodes"].collect()) == 2 * 4 * (6 if everything else 3)


def _after_python(names, everything):
    assert len(names["frame"]) == 2 * 2 * 2
    for saved in ("policy", "taught"):
        assert Path(str(names["folder"]), saved, "card.json").exists()


def _after_keeping(names, everything):
    assert Path("runs", "first", MANIFEST).exists()
    for name in ("first", "play-corrected", "pump") if everything else ():
        with Image.open(f"runs/{name}.gif") as image:
            assert image.n_frames > 5


def _after_extending(names, everything):
    """What is said to be short is; all files are used, and what a recording says is learned."""
    files = {block.title: block.text for block in blocks(ROOT / "docs" / "extending.md") if block.title}
    lines = {name: sum(bool(line.strip()) for line in text.splitlines()) for name, text in files.items()}
    assert lines["mytask.py"] <= 25 and lines["mylearner.py"] <= 25 and lines["robot.py"] <= 50
    assert (read_episodes(Path("runs/described"))["status"] == "ok").all()
    assert Path("runs/described/report.html").exists()
    if not everything:
        return
    commands = "".join(
        block.text for block in blocks(ROOT / "docs" / "extending.md") if block.language == "sh"
    )
    outs = re.findall(r"--out runs/(\w+)", commands)
    rows = {out: read_episodes(Path("runs", out)) for out in outs}
    assert {(frame["status"] == "ok").all() for frame in rows.values()} == {True} and len(rows) >= 7
    assert set(rows["linear"]["algo"]) == {"gpc-ns", "mylearner:Linear"}
    assert rows["late"].groupby("delay")["corrections"].sum().gt(0).all()
    # What was said about a step that the sweep's episode has, is learned there; the robot's went on for longer.
    length = rows["replayed"]["length"].item()
    told = read_advice("robot.jsonl")
    steps = told.moments[(told.given != 0).any(axis=-1)]  # of its one episode
    corrections = rows["replayed"]["corrections"].sum()
    assert (steps < length - 1).sum() <= corrections <= (steps < length).sum() and steps.size > 0


def _after_comparing(names, everything):
    written = {path.name for path in names["files"]}
    table = re.findall(r"^\| `([\w.]+)`", (ROOT / "docs" / "comparing.md").read_text(), re.MULTILINE)
    assert {*table} - {"alone.csv"} <= written


def _before_policies(everything):
    shutil.copytree(shipped_path("cartpole"), "runs/pole")


def _after_policies(names, everything):
    """The policy, its ONNX, and its C, where a compiler is, say the same."""
    said = [names["action"][0], names["actions"][0, 0]]
    said += [float(names["printed"])] if "printed" in names else []
    assert max(said) - min(said) < 1e-9
    if not everything:
        return
    with Image.open("runs/pole.gif") as image:
        assert image.n_frames > 5


BEFORE = {
    "docs/comparing.md": _before_comparing,
    "docs/policies.md": _before_policies,
    "docs/stores.md": _before_stores,
}
AFTER = {
    "docs/comparing.md": _after_comparing,
    "docs/extending.md": _after_extending,
    "docs/keeping.md": _after_keeping,
    "docs/policies.md": _after_policies,
    "docs/python.md": _after_python,
    "docs/stores.md": _after_stores,
}
"""By the page; `everything` says that what is slow was run too."""
