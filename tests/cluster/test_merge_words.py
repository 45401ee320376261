"""What `gpcjax merge` refuses."""

from gpcjax import cli


def test_merge_on_the_command_line(tmp_path, capsys):
    assert cli.main(["merge", str(tmp_path)]) == cli.MISTAKE
    assert "manifest.json: cannot be read" in capsys.readouterr().err
    assert cli.main(["merge"]) == cli.MISTAKE
    assert "FOLDER is missing" in capsys.readouterr().err
