"""Every page, as a reader would follow it: its files are written, its commands typed, its Python run, in order."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import pytest

from gpcjax import cli, registry
from gpcjax.sweep.options import OPTIONS
from tests.docs import checks
from tests.docs.commands import Typist
from tests.docs.pages import DEFAULTS, PAGES, ROOT, WAYS, Block, blocks, name_of

CODE = {name_of(page): blocks(page) for page in PAGES if blocks(page)}

SHORTER = {
    "docs/python.md": {
        'make_learner("gpc", "cartpole")': 'make_learner("coach", "cartpole")',
        'gpcjax.make_env("cartpole")': 'gpcjax.make_env("cartpole", max_steps=20)',
        "in range(5)": "in range(2)",
        'algo="gpc", error=[0, 0.1]': 'algo="coach", oracle="lqr", error=[0, 0.1]',
    }
}
"""What a page says at length, and shorter: a loop's steps would be as the others, a learner takes longer to compile."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where the commands of a page are typed. Afterwards nobody knows its modules any more."""
    place, known = tmp_path / "page", set(sys.modules)
    place.mkdir()
    (place / "sweeps").symlink_to(ROOT / "sweeps")
    monkeypatch.chdir(place)
    monkeypatch.setattr(sys, "path", [*sys.path])
    # A window opens nowhere, and no lesson waits for a person.
    for command in ("gpcjax.play.command", "gpcjax.deploy.command"):
        monkeypatch.setattr(f"{command}.compute_here", lambda: None)
    monkeypatch.setattr("gpcjax.play.showing.has_window", lambda: False)
    monkeypatch.setattr("gpcjax.teach.run.teach", lambda *words: 0)
    # Nothing of ours: a reader's own arrays are broadcast as jax does it.
    jax.config.update("jax_numpy_rank_promotion", "allow")
    yield place
    jax.config.update("jax_numpy_rank_promotion", "raise")
    for name in {*sys.modules} - known:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(place)):
            del sys.modules[name]
    for kind, name in [key for key in registry._FOUND if key[1] not in registry.built_in(key[0])]:
        del registry._FOUND[kind, name]


@pytest.mark.usefixtures("workers_in_process", "figures_unpainted")
@pytest.mark.parametrize("page", CODE)
def test_page(page, folder, tmp_path, request, capsys):
    everything = request.config.option.both_tiers
    project = tmp_path / "project"
    project.mkdir()
    typist, names = Typist(project), {"__name__": "page"}
    for block in CODE[page]:
        if block.title:
            Path(block.title).write_text(block.text)
    checks.BEFORE.get(page, lambda everything: None)(everything)
    for block in CODE[page]:
        if block.way == "not":
            continue
        way = block.way
        if way == "slow":
            way = "run" if everything else block.otherwise
        try:
            _take(block, way, typist, names)
        except (Exception, SystemExit) as error:
            error.add_note(f"{block.place}, {way}: {capsys.readouterr().err}")
            raise
    checks.AFTER.get(page, lambda names, everything: None)(names, everything)


def _take(block: Block, way: str, typist: Typist, names: dict[str, object]) -> None:
    match block.language:
        case "sh":
            for command in block.commands:
                typist.type(command, way)
        case "c" if way == "run":
            Path("runs/main.c").write_text(block.text)
            if shutil.which("cc"):
                strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
                subprocess.run(["cc", *strict, "main.c", "-o", "main", "-lm"], check=True, cwd="runs")
                done = subprocess.run(["runs/main"], check=True, capture_output=True, text=True)
                names["printed"] = done.stdout
        case "toml":
            found = tomllib.loads(block.text)
            if {*found} & {*OPTIONS}:
                Path("settings.toml").write_text(block.text)
                command = "tune" if "tune" in found else "sweep"
                assert cli.main([command, "settings.toml", "--jobs=1", "--dry-run"]) == 0
        case "python":
            text = block.text
            for said, shorter in SHORTER.get(block.page, {}).items():
                text = text.replace(said, shorter)
            code = compile("\n" * block.line + text, str(ROOT / block.page), "exec")
            if way == "run" and not block.title:
                for package in re.findall(r"^import (polars|duckdb|onnxruntime)\b", text, re.MULTILINE):
                    pytest.importorskip(package)
                exec(code, names)


@pytest.mark.parametrize("page", CODE)
def test_each_block_says_how_it_is_tested(page):
    """What is not tested at all is said to the reader; what a page shortens is there."""
    for block in CODE[page]:
        assert {block.way, block.otherwise} <= WAYS, (
            f"{block.place}: how is a block of {block.language} tested?"
        )
        if block.way == "not":
            assert "not run by a test" in (ROOT / page).read_text(), block.place
        assert block.language in DEFAULTS or block.way == "not", block.place
    for said in SHORTER.get(page, {}):
        assert sum(block.text.count(said) for block in CODE[page]) == 1


def test_pages_have_code_and_files_do_not_leave_the_folder():
    assert len(CODE) > 10 and os.sep not in "".join(block.title for each in CODE.values() for block in each)
