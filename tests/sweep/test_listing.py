"""What `gpcjax runs` and `gpcjax show` tell of run folders."""

import json
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from gpcjax import cli
from gpcjax.sweep import run as run_module
from gpcjax.sweep.listing import commands, contents, look, run_folders
from gpcjax.sweep.lock import held, holder
from gpcjax.sweep.manifest import write_manifest
from gpcjax.sweep.plan import hash_of
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import spec_of
from tests.sweep.folders import begun, manifest_of
from tests.sweep.pretended import Pretended

SETTINGS = {
    "env": "cartpole",
    "algo": ["gpc", "coach"],
    "error": [0, 0.1],
    "seeds": 2,
    "episodes": 3,
    "oracle": "lqr",
}


@pytest.fixture
def pretended(monkeypatch):
    pretended = Pretended()
    monkeypatch.setattr(run_module, "Processes", pretended)
    return pretended


@pytest.fixture
def several(tmp_path, monkeypatch, pretended):
    """A complete folder, an interrupted one below another folder, one whose manifest is damaged, and no run folder."""
    sweep(tmp_path / "complete", **SETTINGS)
    monkeypatch.setattr(run_module, "Processes", Pretended(fails_after=3))
    with pytest.raises(KeyboardInterrupt):
        sweep(tmp_path / "all" / "interrupted", **SETTINGS)
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "manifest.json").write_text("{")
    (tmp_path / "notes").mkdir()
    return tmp_path


def test_a_folder_that_may_not_be_read_hides_no_other(several, monkeypatch, capsys):
    (several / "closed" / "run").mkdir(parents=True)
    iterdir, stat = Path.iterdir, Path.stat

    def denied(call, path, *arguments, **options):
        if "closed" in path.parts[:-1] or (call is iterdir and "closed" in path.parts):
            raise PermissionError(13, "Permission denied", str(path))
        return call(path, *arguments, **options)

    monkeypatch.setattr(Path, "iterdir", lambda path: denied(iterdir, path))
    monkeypatch.setattr(Path, "stat", lambda path, **options: denied(stat, path, **options))
    assert len(list(run_folders(several))) == 3
    assert cli.main(["runs", str(several / "closed")]) == 2
    assert "closed: cannot be read (Permission denied)" in capsys.readouterr().err


def test_each_folder_has_its_state(several):
    found = {str(each.path.relative_to(several)): each for each in run_folders(several)}
    assert {name: each.state for name, each in found.items()} == {
        "complete": "complete",
        "all/interrupted": "interrupted",
        "damaged": "not readable",
    }
    assert (found["complete"].finished, found["complete"].cells) == (8, 8)
    assert (found["all/interrupted"].finished, found["all/interrupted"].cells) == (3, 8)


def test_who_writes_there_is_told(several):
    out = several / "all" / "interrupted"
    with held(out):
        seen = []
        looking = threading.Thread(target=lambda: seen.append(look(out)))
        looking.start()
        looking.join()
    (folder,) = seen
    assert folder.state == "going on" and folder.note.startswith("process ")
    assert look(out).state == "interrupted" and holder(out) is None


def test_looking_does_not_get_in_the_way(several):
    """Somebody looks all the time while another process takes the lock."""
    out, stop = several / "complete", threading.Event()

    def look_on():
        while not stop.is_set():
            holder(out)

    looking = threading.Thread(target=look_on)
    looking.start()
    try:
        code = (
            "import sys, pathlib\nfrom gpcjax.sweep.lock import held\n"
            "for _ in range(200):\n    with held(pathlib.Path(sys.argv[1])): pass\n"
        )
        done = subprocess.run([sys.executable, "-c", code, str(out)], capture_output=True, text=True)
    finally:
        stop.set()
        looking.join()
    assert done.returncode == 0, done.stderr


def test_contents_are_checked(several):
    out = several / "complete"
    assert contents(look(out)).finished == 8
    (part,) = (out / "episodes").iterdir()
    data = bytearray(part.read_bytes())
    data[50] ^= 1
    part.write_bytes(data)
    (out / "episodes" / "mine.parquet").write_bytes(b"x")
    found = contents(look(out))
    assert found.finished == 0 and found.foreign == ("episodes/mine.parquet",)
    assert found.damaged == (f"episodes/{part.name}: its checksum differs",)


def test_the_command_makes_the_same(tmp_path):
    """What is said to have made a folder asks for the same specification, also for what has no flag."""
    specs = [
        spec_of(**SETTINGS),
        spec_of(
            env="pendulum", algo="gpc", seeds="3-5", policy_variance=[0.1, 0.25], sparsify=False, rate=1e-7
        ),
        spec_of(env="cartpole", rate_schedule=[0.5, 0.1], algo="coach", oracle="lqr", error=0.3, delta=0.0),
    ]
    from gpcjax.cli import words
    from gpcjax.sweep.spec import make_spec

    for spec in specs:
        (line,) = commands(manifest_of(spec), tmp_path / "it's here")
        import shlex

        arguments = words.parse_words(shlex.split(line)[1:])
        given = words.settings(arguments)
        assert given.pop("out").value == str(tmp_path / "it's here")
        assert make_spec(given) == spec


def test_runs(several, capsys):
    assert cli.main(["runs", str(several)]) == 0
    told = capsys.readouterr().out
    assert "all/interrupted" in told and "3/8" in told and "GPC, COACH" in told and "not readable" in told
    assert cli.main(["runs", str(several), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {line["state"] for line in lines} == {"complete", "interrupted", "not readable"}
    assert cli.main(["runs", str(several / "nowhere")]) == 2
    assert "no such folder" in capsys.readouterr().err
    assert cli.main(["runs", str(several / "notes")]) == 0
    assert "it holds no run folders" in capsys.readouterr().out


def test_show(several, capsys):
    assert cli.main(["show", str(several / "all" / "interrupted")]) == 0
    told = capsys.readouterr().out
    assert "3 of 8" in told and "goes on with" in told and "gpcjax sweep --env cartpole" in told
    assert cli.main(["show", str(several / "complete"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["finished"] == 8
    assert cli.main(["show", str(several / "damaged")]) == 0
    assert "not readable" in capsys.readouterr().out
    assert cli.main(["show", str(several / "notes")]) == 2
    assert "this is no run folder" in capsys.readouterr().err


ODD = {
    "an infinite time": {"wall_time_s": float("inf")},
    "a time that is no number": {"wall_time_s": float("nan")},
    "a negative time": {"compile_time_s": -1.0},
    "yes for a number": {"env_steps": True},
    "a word for a number": {"finished": "x"},
    "a number for machines": {"further_machines": 7},
    "a machine that is none": {"further_machines": ["x"]},
    "requests without anything": {"asked": [{}], "format": 4},
    "requests of something else": {
        "asked": [{"hash": "a", "specification": {}, "filled": {}}],
        "format": 4,
    },
    "no seeds": {"specification": {"env": "cartpole", "hyperparameters": {}}},
    "seeds that are none": {"specification": {"seeds": "many"}},
    "errors that are none": {"specification": {"error": 0.1}},
    "learners that are none": {"specification": {"algo": [3]}},
    "episodes that are none": {"specification": {"episodes": "3"}},
}


@pytest.mark.parametrize("odd", ODD.values(), ids=ODD)
@pytest.mark.parametrize("sealed", [True, False])
def test_one_odd_manifest_does_not_end_the_list(tmp_path, capsys, odd, sealed):
    begun(tmp_path / "sound", spec_of(**SETTINGS))
    manifest = {**manifest_of(spec_of(**SETTINGS)), "format": 3 if sealed else 2} | odd
    if "specification" in odd:
        specification = {**manifest_of(spec_of(**SETTINGS))["specification"], **odd["specification"]}
        manifest["specification"] = odd["specification"] if len(odd["specification"]) > 1 else specification
        manifest |= {"hash": hash_of(manifest["specification"]), "varying": []}
    if sealed:
        (tmp_path / "odd").mkdir()
        write_manifest(tmp_path / "odd", manifest)
    else:
        (tmp_path / "odd").mkdir()
        (tmp_path / "odd" / "manifest.json").write_text(json.dumps(manifest))
    assert {each.path.name: each.state for each in run_folders(tmp_path)} == {
        "sound": "interrupted",
        "odd": "not readable",
    }
    for words in (["runs", str(tmp_path)], ["show", str(tmp_path / "odd")]):
        for more in ([], ["--json"]):
            assert cli.main([*words, *more]) == 0
    told = capsys.readouterr()
    assert "not readable" in told.out and not told.err


def test_a_folder_whose_episodes_are_gone_is_not_complete(several, capsys, monkeypatch):
    shutil.rmtree(several / "complete" / "episodes")
    folder = look(several / "complete")
    assert (folder.state, folder.note, folder.finished) == ("interrupted", "its episodes are gone", 0)
    assert cli.main(["runs", str(several)]) == 0
    assert "0/8" in capsys.readouterr().out
    monkeypatch.setattr(run_module, "Processes", Pretended())
    sweep(several / "complete", **SETTINGS)
    assert look(several / "complete").state == "complete"


def test_files_may_go_while_they_are_looked_at(several, monkeypatch):
    """A sweep that is going on removes what it has put together."""
    folder, names = look(several / "complete"), []
    whole = contents(folder)

    def stat(path, **options):
        names.append(path.name)
        if len(names) % 3 == 0:
            raise FileNotFoundError(path)
        return old(path, **options)

    old = Path.stat
    monkeypatch.setattr(Path, "stat", stat)
    assert 0 < contents(folder).size < whole.size


def test_a_folder_of_an_unknown_learner_is_listed(tmp_path):
    """Nothing of somebody's own is imported for it."""
    manifest = manifest_of(spec_of(**SETTINGS))
    specification = {**manifest["specification"], "algo": ["nowhere:Learner"], "env": "nowhere:Task"}
    begun(tmp_path, spec_of(**SETTINGS))
    write_manifest(tmp_path, {**manifest, "specification": specification, "hash": hash_of(specification)})
    folder = look(tmp_path)
    assert folder.state == "interrupted" and folder.as_json()["algo"] == ["nowhere:Learner"]
