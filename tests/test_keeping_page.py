"""docs/keeping.md, as a reader would follow it: each command and the snippet, in their order."""

import re
import shlex
from pathlib import Path

import pytest
from PIL import Image

from gpcjax import cli
from gpcjax.sweep.layout import MANIFEST

PAGE = (Path(__file__).parents[1] / "docs" / "keeping.md").read_text()
BLOCKS = re.findall(r"```(sh|python)\n(.*?)\n```", PAGE, re.DOTALL)


@pytest.mark.usefixtures("workers_in_process", "figures_unpainted")
def test_the_page(tmp_path, monkeypatch, capsys):
    """Sweeps from which others go on are run, and what is played; for the rest the same words are understood."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gpcjax.play.command.compute_here", lambda: None)
    monkeypatch.setattr("gpcjax.play.showing.has_window", lambda: False)
    lessons = []
    monkeypatch.setattr("gpcjax.teach.run.teach", lambda *words: lessons.append(words) or 0)
    for language, text in BLOCKS:
        if language == "python":
            exec(compile(text, "docs/keeping.md", "exec"), {})
            continue
        for line in text.splitlines():
            program, command, *words = shlex.split(line)
            assert program == "gpcjax"
            if command == "sweep":
                words += ["--jobs=1"] if words[-1] == "runs/first" else ["--jobs=1", "--dry-run"]
            if command == "play":
                words += ["--seconds=0.5"]
            assert cli.main([command, *words]) == 0, capsys.readouterr().err
    ((folder, course, run, *_),) = lessons
    assert (str(folder), course.env, course.algo, run.seed) == ("runs/by-hand", "mountaincar", "coach", 1)
    assert (tmp_path / "runs" / "first" / MANIFEST).exists()
    for name in ("first", "play-corrected", "pump"):
        with Image.open(tmp_path / "runs" / f"{name}.gif") as image:
            assert image.n_frames > 5
