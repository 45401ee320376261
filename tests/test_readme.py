"""The README tells the truth: its Python runs, in fewer steps; its commands name targets and variables that exist."""

import re
from pathlib import Path

import pytest

from gpcjax import cli

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


def test_python_runs_in_order(tmp_path, monkeypatch, workers_in_process):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    python = "\n".join(blocks("python"))
    # Each of the loop's steps would be as the others.
    assert python.count("situation.time == 200") == 1
    exec(compile(python.replace("situation.time == 200", "situation.time == 20"), "README.md", "exec"), names)
    frame = names["frame"]
    assert len(frame) == 2 * 2 * 2
    for saved in ("policy", "taught"):
        assert (Path(str(names["folder"])) / saved / "card.json").exists()


COMMANDS = [
    line.partition("#")[0].strip()
    for block in blocks("sh")
    for line in block.splitlines()
    if line.startswith("make")
]


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_are_accepted(command, tmp_path, monkeypatch, capsys):
    """Each sweep and grid is checked as the Makefile would hand it over; the other targets exist."""
    _, target, *settings = command.split()
    makefile = (ROOT / "Makefile").read_text()
    assert re.search(rf"^{target}:", makefile, re.MULTILINE)
    if target not in ("sweep", "grid"):
        return
    flags = dict(pair.split(":") for pair in re.findall(r"\b[A-Z]+:[a-z-]+", makefile))
    words = [target, "--dry-run", "--out", str(tmp_path / "out")]
    for setting in settings:
        name, _, value = setting.partition("=")
        words += [str(ROOT / value)] if name == "SPEC" else [f"--{flags[name]}={value}"]
    assert cli.main(words) == 0
    assert "cells of" in capsys.readouterr().out


def test_pictures_exist():
    for path in re.findall(r"!\[[^]]*\]\(([^)]+)\)", README):
        assert (ROOT / path).stat().st_size > 1000, path


def test_the_claims_are_those_of_the_reproduction():
    shown = re.search(r"<!-- claims -->\n(.*?)<!-- /claims -->", README, re.DOTALL)
    assert shown and shown[1] == (ROOT / "docs" / "reproduction" / "claims.md").read_text()
    assert shown[1].count("\n") > 30
