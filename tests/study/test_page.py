"""docs/study.md from rows to figures: its snippets run, and its words are understood."""

import re
import shlex
from pathlib import Path

import matplotlib
import pytest

from gpcjax import cli
from gpcjax.study.bots import crowd
from tests.study.written import study_of

PAGE = (Path(__file__).parents[2] / "docs" / "study.md").read_text()


def section(title):
    return PAGE[PAGE.index(f"## {title}") :].split("\n## ")[0]


def blocks(title, language):
    return re.findall(rf"```{language}\n(.*?)\n```", section(title), re.DOTALL)


@pytest.mark.slow
def test_from_the_rows_to_the_papers_figure(tmp_path, monkeypatch, capsys):
    made = tmp_path / "made"
    made.mkdir()
    out, _ = study_of(made)
    (tmp_path / "runs").mkdir()
    out.rename(tmp_path / "runs" / "study")
    monkeypatch.chdir(tmp_path)
    title = "From the rows to the paper's figure"
    (command,) = blocks(title, "sh")
    program, *words = shlex.split(command)
    assert program == "gpcjax" and cli.main(words) == 0, capsys.readouterr().err
    said = capsys.readouterr().out
    assert "wrote runs/study/analysis/report.html" in said
    matplotlib.use("agg")
    figure, others = blocks(title, "python")
    told = {}
    exec(compile(figure, "docs/study.md", "exec"), told)
    assert told["difference"]["mean"].tolist() == [2.0, 2.0] and told["difference"]["count"].tolist() == [
        3,
        3,
    ]
    assert {path.name for path in tmp_path.glob("*.pdf")} == {"cartpole.pdf", "pendulum.pdf"}
    exec(compile(others, "docs/study.md", "exec"), told)
    assert len(told["rows"]) == 6 and len(told["advice"]) == 3


def test_a_rehearsal_with_bots(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(crowd, "rehearse", lambda *given, **how: asked.append(given) or [])
    line = next(
        line for text in blocks("Rehearse it", "sh") for line in text.splitlines() if " bots " in line
    )
    assert cli.main(shlex.split(line)[1:]) == 0
    assert asked == [("http://127.0.0.1:8765/", 16, 0)]


def test_words_that_do_not_fit(tmp_path, capsys):
    for words, message in {
        ("study", "report"): "gpcjax study report: give OUT behind it",
        ("study", "bots"): "gpcjax study bots: give ADDRESS behind it",
        ("study", "report", str(tmp_path)): "no study is kept there",
        ("study", "report", "x", "--out", "y"): "--out: beside report it changes nothing",
        ("study", "bots", "http://a/", "--port", "1"): "--port: beside bots it changes nothing",
        ("study", "x.toml", "--number", "3"): "--number: without bots it changes nothing",
        ("study", "bots", "http://127.0.0.1:1/", "--number", "0"): "--number",
        ("study", "bots", "http://127.0.0.1:1/"): "no study answers there",
    }.items():
        assert cli.main(list(words)) == 2
        assert message in capsys.readouterr().err
