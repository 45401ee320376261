"""The commands of docs/cluster.md: each is one that gpcjax, its scripts and make take; those of the shards are run."""

import re
import shlex
from pathlib import Path

from gpcjax import cli
from gpcjax.cli.words import parse_words, settings
from gpcjax.sweep.spec import make_spec

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "cluster.md").read_text()
LINES = [
    shlex.split(line, comments=True)
    for block in re.findall(r"^```sh\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
    for line in block.splitlines()
]


def test_every_command_is_one(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert {words[0] for words in LINES} == {"gpcjax", "make", "sbatch", "sweeps/cluster/ray.sh"}
    for words in LINES:
        match words:
            case ["gpcjax", "sweep", *_]:
                assert cli.main([*words[1:], "--dry-run"]) == 0, capsys.readouterr().err
            case ["gpcjax", *_]:
                assert parse_words(words[1:]).command == "merge"
            case ["sbatch", _, script, *rest]:
                assert (ROOT / script).is_file()
                make_spec(settings(parse_words(["sweep", *rest])))
            case ["make", "sweep", *variables]:
                taken = re.search(r"^FLAGS := (.*\\\n)*.*$", (ROOT / "Makefile").read_text(), re.MULTILINE)[0]
                known = {pair.partition(":")[0] for pair in taken.split() if ":" in pair}
                assert {word.partition("=")[0] for word in variables} <= known
            case [script, *_]:
                assert (ROOT / script).is_file()


def test_files_that_it_names_are_there():
    for name in re.findall(r"\]\((\.\./[^)#]+)\)", TEXT):
        assert (ROOT / "docs" / name).resolve().is_file()


def test_merge_on_the_command_line(tmp_path, capsys):
    assert cli.main(["merge", str(tmp_path)]) == cli.MISTAKE
    assert "manifest.json: cannot be read" in capsys.readouterr().err
    assert cli.main(["merge"]) == cli.MISTAKE
    assert "FOLDER is missing" in capsys.readouterr().err
