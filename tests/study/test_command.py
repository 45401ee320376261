"""`gpcjax study` on the command line: one line for each mistake; status and deletion."""

import json

import pytest

from gpcjax import cli
from gpcjax.study.register import ANALYSIS, Register
from gpcjax.sweep.lock import held
from tests.study.example import study_with


@pytest.fixture
def said(capsys):
    """Runs words, and gives the status and what was printed."""

    def run(*words):
        status = cli.main(["study", *map(str, words)])
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.mark.parametrize(
    "words, told",
    [
        ((), "no study: give its TOML file"),
        (("none.toml",), "none.toml: cannot be read"),
        (("a.toml", "b.toml"), "'b.toml' is one value too many"),
        (("status",), "gpcjax study status: give OUT behind it"),
        (("status", "none"), "none: no study is kept there"),
        (("status", "none", "--port", "3"), "--port: beside status it changes nothing"),
        (("delete", "none"), "gpcjax study delete: give OUT CODE behind it"),
        (("delete", "none", "a1"), "none: no study is kept there"),
        (("--out", "none"), "none: no study is kept there"),
        (("a.toml", "--places", "0"), "--places 0: give a whole number from 1 to 512"),
        (("a.toml", "--port", "x"), "--port 'x'"),
        (("a.toml", "--adress", "x"), "did you mean --address"),
    ],
)
def test_a_mistake_is_one_line(said, tmp_path, monkeypatch, words, told):
    monkeypatch.chdir(tmp_path)
    status, out, err = said(*words)
    assert status == 2 and told in err and out == "" and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [], "nothing was made"


def test_an_address_without_tls_is_refused_before_it_begins(said, tmp_path):
    out, _ = study_with(tmp_path)
    status, _, err = said("--out", out, "--address", "http://a.org")
    assert status == 2 and "--address 'http://a.org': give https://HOST" in err


def test_damaged_numbers_are_told_before_anybody_comes(said, tmp_path):
    out, _ = study_with(tmp_path)
    (out / "numbers.json").write_text("{")
    status, _, err = said("--out", out)
    assert status == 2 and "numbers.json: it is damaged" in err and err.count("\n") == 1


def test_where_everybody_is(said, tmp_path):
    out, study = study_with(tmp_path)
    assert "nobody has come yet" in said("status", out)[1]
    register = Register(out, study)
    one = register.admit("a1")
    one.advance("consent")
    register.admit("b2").end("declined")
    _, told, _ = said("status", out)
    head, names, first, second = told.splitlines()
    assert "1 of 4 slots taken, not running" in head and names.split()[:3] == ["number", "code", "state"]
    assert first.split()[:5] == ["1", "a1", "active", "0/8", "check"]
    assert "b2" in second and "declined" in second and "left the study" in second


def test_deleted(said, tmp_path):
    out, study = study_with(tmp_path)
    register = Register(out, study)
    register.admit("a1")
    register.admit("b2")
    (out / ANALYSIS).mkdir()
    (out / ANALYSIS / "report.html").write_text("a1 and b2")
    status, told, _ = said("delete", out, "a1")
    assert status == 0 and "p0001 (2 files)" in told and str(out / ANALYSIS) in told
    assert [json.loads(path.read_text())["code"] for path in out.rglob("participant.json")] == ["b2"]
    status, _, err = said("delete", out, "a1")
    assert status == 2 and "nobody has the code 'a1'" in err


def test_what_runs_is_left_alone(said, tmp_path):
    out, study = study_with(tmp_path)
    Register(out, study).admit("a1")
    with held(out):
        status, _, err = said("delete", out, "a1")
        assert status == 2 and "delete a1 on the experimenter's page" in err
        status, _, err = said("--out", out)
        assert status == 2 and "the study runs already" in err
        assert "running" in said("status", out)[1]
    assert any(out.rglob("participant.json"))
