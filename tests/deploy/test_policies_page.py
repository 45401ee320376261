"""docs/policies.md, as a reader would follow it: its commands, its Python and its C."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import gpcjax
from gpcjax import cli
from gpcjax.cli.words import parse_words
from gpcjax.policies.saved import shipped_path

PAGE = (Path(__file__).parents[2] / "docs" / "policies.md").read_text()
BLOCKS = re.findall(r"```(sh|python|c)\n(.*?)\n```", PAGE, re.DOTALL)


def test_the_page(tmp_path, monkeypatch, capsys):
    """What is of folders that no command here makes is understood; all else is run."""
    for name in ("gpcjax.deploy.command", "gpcjax.play.command"):
        monkeypatch.setattr(f"{name}.compute_here", lambda: None)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    shutil.copytree(shipped_path("cartpole"), "runs/pole")
    names, done = {}, []
    for language, text in BLOCKS:
        match language:
            case "python":
                if "onnxruntime" in text:
                    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
                exec(compile(text.replace("range(1000)", "range(3)"), "docs/policies.md", "exec"), names)
            case "c":
                (tmp_path / "runs" / "main.c").write_text(text)
            case "sh":
                for line in text.splitlines():
                    program, *words = shlex.split(line)
                    assert program == "gpcjax" and parse_words(words).command == "policy"
                    if "runs/first" in words or "mytask:Drift" in words:
                        continue
                    words = [word if word != "20" else "2" for word in words]
                    words += ["--seconds=0.1"] if "gif" in words else []
                    assert cli.main(words) == 0, capsys.readouterr().err
                    done.append(words[1])
    assert done == ["info", "eval", "gif", "eval", "export", "export", "export"]
    assert names["actions"].shape == (2, 1)
    if shutil.which("cc") is not None:
        strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
        subprocess.run(["cc", *strict, "main.c", "-o", "main", "-lm"], check=True, cwd="runs")
        said = subprocess.run(["runs/main"], check=True, capture_output=True, text=True).stdout
        policy = gpcjax.load_policy("runs/pole")
        assert abs(float(said) - policy([0.1, 0.0, 0.02, 0.0])[0]) < 1e-9
        assert abs(float(said) - names["actions"][0, 0]) < 1e-9


def test_the_help_of_each_command_names_its_flags(capsys):
    for words, flags in (
        ([], ("info", "eval", "export", "gif")),
        (["eval"], ("--episodes", "--seed", "--where", "--env", "--json")),
        (["export"], ("--to", "--out", "--name", "--seed", "--where", "--env", "--json")),
        (["gif"], ("--out", "--seed", "--episodes", "--speed", "--seconds")),
        (["info"], ("--seed", "--json")),
    ):
        with pytest.raises(SystemExit) as stop:
            cli.main(["policy", *words, "--help"])
        said = capsys.readouterr().out
        assert stop.value.code == 0 and all(flag in said for flag in flags)
        assert "%%" not in said and f"usage: gpcjax policy {' '.join(words)}".rstrip() in said
