import json

import pytest

from gpcjax.errors import UserError
from gpcjax.sweep.plan import specification_hash
from gpcjax.sweep.runfolder import FORMAT, check_report, check_sweep, make_writable, read_manifest
from gpcjax.sweep.spec import as_dict, spec_of

SPEC = spec_of(env="cartpole", error=[0, 0.1])


def write_manifest(out, spec=SPEC, **change):
    out.mkdir(parents=True, exist_ok=True)
    manifest = {"format": FORMAT, "hash": specification_hash(spec), "specification": as_dict(spec)} | change
    (out / "manifest.json").write_text(json.dumps(manifest))


def refusal(function, *arguments):
    with pytest.raises(UserError) as error:
        function(*arguments)
    return str(error.value)


def test_a_new_folder_will_do(tmp_path):
    check_sweep(tmp_path / "a" / "b", SPEC)
    assert not list(tmp_path.iterdir())
    make_writable(tmp_path / "a" / "b")
    assert not list((tmp_path / "a" / "b").iterdir())


def test_the_same_sweep_goes_on_in_its_folder(tmp_path):
    write_manifest(tmp_path)
    (tmp_path / "episodes").mkdir()
    (tmp_path / "report.html").touch()
    check_sweep(tmp_path, SPEC)
    check_sweep(tmp_path, spec_of(env="cartpole", error=[0.1, 0]))


def test_what_a_kill_left_before_the_manifest_is_no_hindrance(tmp_path):
    (tmp_path / "episodes").mkdir()
    (tmp_path / ".manifest.json.0123.tmp").touch()
    check_sweep(tmp_path, SPEC)


def test_another_sweep_is_refused_with_what_differs(tmp_path):
    write_manifest(tmp_path)
    message = refusal(check_sweep, tmp_path, spec_of(env="cartpole", error=[0, 0.2], seeds=3))
    assert f"{tmp_path}: it holds another specification (error, seeds), give a new folder" in message


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").touch()
    assert f"{tmp_path}: it holds 'thesis.tex' and no run" in refusal(check_sweep, tmp_path, SPEC)


def test_a_file_is_refused(tmp_path):
    (tmp_path / "file").touch()
    assert "this is no folder" in refusal(check_sweep, tmp_path / "file", SPEC)
    assert "Not a directory" in refusal(check_sweep, tmp_path / "file" / "below", SPEC)


@pytest.mark.parametrize("name", ["x" * 300, "a\0b"], ids=["too long", "null byte"])
def test_an_impossible_name_is_refused(tmp_path, name):
    assert "no folder can be there" in refusal(check_sweep, tmp_path / name, SPEC)


def test_unwritable(tmp_path):
    (tmp_path / "file").touch()
    assert "nothing can be written there" in refusal(make_writable, tmp_path / "file" / "below")


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", "\udcff", '{"format": 2, "hash": 3, "specification": {}}']
)
def test_a_broken_manifest_is_refused(tmp_path, text):
    (tmp_path / "manifest.json").write_bytes(text.encode(errors="surrogateescape"))
    for function, arguments in ((read_manifest, ()), (check_report, ()), (check_sweep, (SPEC,))):
        assert f"{tmp_path / 'manifest.json'}: " in refusal(function, tmp_path, *arguments)


def test_a_manifest_of_another_format_is_refused(tmp_path):
    """Format 1 lacks columns that rows have now."""
    write_manifest(tmp_path, format=1)
    assert "format 1 is not known, this version reads format 2" in refusal(read_manifest, tmp_path)


def test_report_needs_episodes(tmp_path):
    assert "no such folder" in refusal(check_report, tmp_path / "none")
    assert "manifest.json: cannot be read" in refusal(check_report, tmp_path)
    write_manifest(tmp_path)
    assert "it holds no episodes yet" in refusal(check_report, tmp_path)
    (tmp_path / "episodes").mkdir()
    (tmp_path / "episodes" / "0.parquet").touch()
    check_report(tmp_path)
