"""`gpcjax policy --help` and that of its commands."""

import pytest

from gpcjax import cli


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
