import json

import pytest

from gpcjax.errors import UserError
from gpcjax.sweep.layout import BESIDE, EPISODES, FORMAT, GROWN, UNSEALED, parse_part, part_name
from gpcjax.sweep.lock import LOCK
from gpcjax.sweep.manifest import read_manifest, write_manifest
from gpcjax.sweep.plan import specification_hash
from gpcjax.sweep.runfolder import check_report, check_sweep, make_writable, set_aside
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import Store
from tests.sweep.folders import begun, manifest_of

SPEC = spec_of(env="cartpole", error=[0, 0.1])


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
    begun(tmp_path, SPEC)
    (tmp_path / "episodes").mkdir()
    (tmp_path / "report.html").touch()
    check_sweep(tmp_path, SPEC)
    check_sweep(tmp_path, spec_of(env="cartpole", error=[0.1, 0]))


def test_what_a_kill_left_before_the_manifest_is_no_hindrance(tmp_path):
    (tmp_path / "episodes").mkdir()
    (tmp_path / ".gpcjax-4999999-0123456789ab.manifest.json.tmp").touch()
    (tmp_path / LOCK).touch()
    check_sweep(tmp_path, SPEC)


def test_nor_are_runs_under_way_of_a_folder_that_was_removed(tmp_path):
    """A worker may write a checkpoint while somebody removes the folder around it."""
    for name in ("1795715941520164536-10949-0", ".1795715941520164536-10949-1-ab_c"):
        (tmp_path / "checkpoints" / name).mkdir(parents=True)
    check_sweep(tmp_path, SPEC)


@pytest.mark.parametrize(
    "name",
    [
        "thesis.tex",
        ".hidden",
        "episodes/my_data.json",
        "corrections/.x.tmp",
        "episodes/deep/er",
        "notes/a",
        "report.html",
        "damaged/episodes/x",
        "checkpoints",
        "checkpoints/mine",
        f"episodes/part-00000-{'0' * 12}-{'0' * 32}.parquet",
        f"episodes/part-00000-{'0' * 12}.parquet",
    ],
)
def test_without_a_manifest_a_folder_must_be_empty(tmp_path, name):
    """Whatever it holds is not ours."""
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("mine")
    message = refusal(check_sweep, tmp_path, SPEC)
    assert message.startswith(f"{tmp_path}: it holds ") and message.endswith("(--out)")
    assert "\n" not in message and path.read_text() == "mine"


def test_without_a_manifest_a_part_can_say_whose_it_is(tmp_path):
    part = tmp_path / "episodes" / part_name(3, specification_hash(SPEC), b"rows")
    part.parent.mkdir()
    part.write_bytes(b"rows")
    (tmp_path / "report.html").touch()
    check_sweep(tmp_path, SPEC)
    other = spec_of(env="cartpole", error=[0, 0.2])
    assert "it holds rows of another sweep and no manifest" in refusal(check_sweep, tmp_path, other)


def test_a_file_in_the_place_of_a_folder_is_refused(tmp_path):
    begun(tmp_path, SPEC)
    (tmp_path / "episodes").touch()
    assert f"{tmp_path / 'episodes'}: this is no folder" in refusal(check_sweep, tmp_path, SPEC)


def test_another_sweep_is_refused_with_what_differs(tmp_path):
    begun(tmp_path, SPEC)
    message = refusal(check_sweep, tmp_path, spec_of(env="cartpole", episodes=4, sparsify=False))
    assert (
        f"{tmp_path}: it holds another specification (episodes 30, not 4, sparsify True, not False): a folder grows"
        in message
    )


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
    for version in (1, 5):
        begun(tmp_path, SPEC, format=version)
        message = f"format {version} is not known, this version reads the formats 2 to 4"
        assert message in refusal(read_manifest, tmp_path)


def texts(folder, **changes):
    """The manifest as it is written; of format 2 without its sum."""
    path = begun(folder, SPEC, **changes) / "manifest.json"
    if changes.get("format") == UNSEALED:
        written = json.loads(path.read_text())
        del written["sha256"]
        path.write_text(json.dumps(written, indent=2))
    return path, path.read_text()


BASELINES = {
    "idle": {"mean": 20.25, "std": 1.5, "n": 100},
    "oracles": {"lqr": {"mean": 2500.0, "std": 0.0, "n": 100}},
}


def test_any_change_of_a_manifest_is_seen(tmp_path):
    """A bit anywhere that changes what it says."""
    path, text = texts(tmp_path, baselines=BASELINES)
    content, changed = read_manifest(tmp_path), 0
    data = text.encode()
    for position in range(len(data)):
        bit = 1 << (position % 8)
        path.write_bytes(data[:position] + bytes([data[position] ^ bit]) + data[position + 1 :])
        try:
            assert read_manifest(tmp_path) == content  # white space became other white space
        except UserError as error:
            changed += 1
            assert "\n" not in str(error)
    assert changed > 0.6 * len(data)


@pytest.mark.parametrize("version", [UNSEALED, FORMAT])
@pytest.mark.parametrize("value", [None, "7", [], {"a": 1}, "absent"], ids=repr)
def test_a_key_that_is_missing_or_something_else_is_one_line(tmp_path, version, value):
    path, text = texts(tmp_path, format=version, baselines=BASELINES)
    written = json.loads(text)
    for name in written:
        edited = {key: each for key, each in written.items() if key != name or value != "absent"}
        if value != "absent":
            edited[name] = value
        if edited == written:
            continue
        path.write_text(json.dumps(edited))
        for function, arguments in ((read_manifest, ()), (check_report, ()), (check_sweep, (SPEC,))):
            try:
                function(tmp_path, *arguments)
            except UserError as error:
                assert "\n" not in str(error)
            else:
                # Format 2 has no sum: of what needs none of its kind some things pass.
                assert version == UNSEALED and name in ("versions", "machine", "varying", "sha256")


@pytest.mark.parametrize(
    "baselines", [[], {}, {"idle": 1, "oracles": {}}, {"idle": None, "oracles": {"lqr": {"mean": 1}}}]
)
def test_baselines_of_format_2_have_their_form(tmp_path, baselines):
    texts(tmp_path, format=UNSEALED, baselines=baselines)
    assert "manifest.json: it" in refusal(read_manifest, tmp_path)


def test_the_specification_of_format_2_is_checked_by_its_hash(tmp_path):
    path, text = texts(tmp_path, format=UNSEALED)
    read_manifest(tmp_path)
    path.write_text(text.replace("0.1", "0.3"))
    assert "its hash is not that of its specification" in refusal(read_manifest, tmp_path)


def test_a_damaged_manifest_beside_parts_that_say_whose_they_are(tmp_path):
    path, _ = texts(tmp_path)
    path.write_text("{")
    message = "no part beside it says to be of this sweep: restore it, or give a new folder"
    assert message in refusal(check_sweep, tmp_path, SPEC)
    part = tmp_path / "episodes" / part_name(0, specification_hash(SPEC), b"rows")
    part.parent.mkdir()
    part.write_bytes(b"rows")
    check_sweep(tmp_path, SPEC)
    assert message in refusal(check_sweep, tmp_path, spec_of(env="cartpole", error=[0, 0.2]))


def test_a_long_manifest_is_laid_out_by_its_entries(tmp_path):
    """A short one as ever."""
    short = begun(tmp_path, SPEC) / "manifest.json"
    manifest = read_manifest(tmp_path)
    assert short.read_text() == json.dumps(manifest, indent=2) + "\n"
    one = {"hash": manifest["hash"], "specification": manifest["specification"], "filled": {}}
    write_manifest(tmp_path, manifest | {"format": GROWN, "asked": [one] * 100})
    assert len(short.read_text().splitlines()) < 300
    assert read_manifest(tmp_path)["asked"] == [one] * 100


def test_a_manifest_is_read_and_checked_by_any_text_of_the_same_content(tmp_path):
    """Whoever lays it out anew, or sorts its keys, has damaged nothing."""
    path, text = texts(tmp_path, baselines=BASELINES)
    content = read_manifest(tmp_path)
    path.write_text(json.dumps(json.loads(text), sort_keys=True))
    assert read_manifest(tmp_path) == content


class TestSettingAside:
    def test_nothing_is_lost(self, tmp_path):
        for text in ("one", "two", "three"):
            (tmp_path / "episodes").mkdir(exist_ok=True)
            (tmp_path / "episodes" / "a").write_text(text)
            set_aside(tmp_path, tmp_path / "episodes" / "a", tmp_path / "episodes" / "missing")
        kept = {path.name: path.read_text() for path in (tmp_path / "damaged" / "episodes").iterdir()}
        assert kept == {"a": "one", "a.1": "two", "a.2": "three"}
        assert not list((tmp_path / "episodes").iterdir())


@pytest.mark.parametrize("name", ["part-00001-0123456789ab.parquet", part_name(7, "0" * 12, b"")])
def test_names_of_parts(name):
    part = parse_part(name)
    assert part is not None and part.number in (1, 7) and len(part.digest) in (0, 32)
    for other in (
        f"x{name}",
        f"{name}.tmp",
        f".{name}",
        name.upper(),
        name.replace(".parquet", " (copy).parquet"),
    ):
        assert parse_part(other) is None


def test_report_needs_episodes(tmp_path):
    assert "no such folder" in refusal(check_report, tmp_path / "none")
    assert "manifest.json: cannot be read" in refusal(check_report, tmp_path)
    begun(tmp_path, SPEC)
    assert "it holds no episodes yet" in refusal(check_report, tmp_path)
    (tmp_path / "episodes").mkdir()
    (tmp_path / "episodes" / "0.parquet").touch()
    check_report(tmp_path)


def test_a_sweep_that_was_killed_before_its_manifest_goes_on(tmp_path):
    """With all the folders that its store makes."""
    Store(tmp_path, manifest_of(SPEC))
    assert len(list(tmp_path.iterdir())) == 1 + len(BESIDE)
    check_sweep(tmp_path, SPEC)
    for folder in (EPISODES, *BESIDE):
        (tmp_path / folder).rmdir()
        (tmp_path / folder).touch()
        assert f"{tmp_path / folder}: this is no folder" in refusal(check_sweep, tmp_path, SPEC)
        (tmp_path / folder).unlink()
