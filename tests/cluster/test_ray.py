"""Sweeps in a Ray that is started for them on this machine: the rows of a plain sweep, whatever becomes of a worker."""

import importlib.util
import json
import os
import signal
import socket
import subprocess
import sys
import time

import pandas as pd
import pytest

from gpcjax import cli
from gpcjax.errors import UserError
from gpcjax.sweep.executors import Executor, Processes, Ray, executor_of
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.reading import read_corrections, read_episodes
from gpcjax.sweep.run import sweep
from tests.cluster.hosts import command_of, descendants

WORDS = ["--env", "lunarlander", "--algo", "coach", "--seeds", "4", "--episodes", "20", "--checkpoint", "1"]
SETTINGS = {"env": "lunarlander", "algo": "coach", "seeds": 4, "episodes": 20}


def assert_same_rows(one, other):
    for read in (read_episodes, read_corrections):
        frames = [read(folder) for folder in (one, other)]
        names = [name for name in ("seed", "episode", "step", "action_dim") if name in frames[0]]
        pd.testing.assert_frame_equal(
            *(frame.sort_values(names, ignore_index=True) for frame in frames), check_exact=True
        )


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_no_rows(tmp_path):
    """The one that is killed has made steps; its runs are begun again, or go on, elsewhere."""
    plain = sweep(tmp_path / "plain", **SETTINGS)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "gpcjax", "sweep", *WORDS, "--engine", "ray", "--jobs", "2", "--json"]
    environment = {**os.environ, "RAY_TMPDIR": "/tmp"}
    with subprocess.Popen(
        [*command, "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as running:
        killed, events = [], []
        for line in running.stdout:
            events.append(json.loads(line))
            if not killed and events[-1].get("env_steps"):
                killed = [
                    pid for pid in descendants(running.pid) if b"executors/served.py" in command_of(pid)
                ][:1]
                os.kill(killed[0], signal.SIGKILL)
        errors = running.stderr.read()
        assert running.wait() == 0, errors
    assert killed and [event["event"] for event in events[-2:]] == ["end", "report"]
    (line,) = errors.splitlines()  # Ray itself says nothing
    assert "is lost, its runs go to others (a worker process was killed by SIGKILL" in line
    assert_same_rows(out, plain)
    manifest = read_manifest(out)
    assert manifest["complete"] and manifest["jobs"] == 2 and "further_machines" not in manifest
    assert not (out / "checkpoints").exists()
    until = time.monotonic() + 20.0
    while descendants(running.pid) and time.monotonic() < until:
        time.sleep(0.1)
    assert not descendants(running.pid)


def test_what_an_engine_is():
    assert executor_of(None, None, 3) is None and executor_of("processes", None, 3) is None
    assert isinstance(executor_of("ray", None, 3), Executor) and executor_of("ray", None, 3).jobs == 3
    with pytest.raises(
        UserError, match=r"^--address auto: without engine ray it changes nothing, give --engine ray"
    ):
        executor_of(None, "auto", None, "--address")
    with pytest.raises(UserError, match=r"^engine 'dask': give processes or ray$"):
        executor_of("dask", None, None)
    with pytest.raises(UserError, match="beside an executor it changes nothing"):
        sweep(executor=Processes(1), engine="ray", **SETTINGS)


def test_without_ray_it_is_one_line(monkeypatch, tmp_path, capsys):
    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name == "ray" else real(name, *more)
    )
    assert cli.main(["sweep", *WORDS, "--engine", "ray", "--out", str(tmp_path / "out")]) == cli.MISTAKE
    assert (
        capsys.readouterr().err
        == "gpcjax: error: engine ray: Ray is not installed: pip install 'gpcjax[cluster]'\n"
    )
    assert not (tmp_path / "out").exists()


def test_the_words_of_the_command(tmp_path, capsys):
    given = ["--dry-run", "--out", str(tmp_path / "out")]
    assert cli.main(["sweep", *WORDS, *given, "--engine", "ray", "--shard", "2/4"]) == 0
    said = capsys.readouterr().out
    assert (
        said
        == f"shard 2/4 of 4 cells of lunarlander, 20 episodes each, in a Ray, into {tmp_path}/out/shards/2-of-4\n"
    )
    for words, message in (
        (["--engine", "dask"], "--engine 'dask': give processes or ray"),
        (["--address", "auto"], "--address auto: without engine ray it changes nothing"),
        (["--shard", "5/4"], "--shard '5/4': give i/n"),
        (["--shard", "1/5"], "shard 1/5: there are 4 cells only"),
    ):
        assert cli.main(["sweep", *WORDS, *given, *words]) == cli.MISTAKE
        assert message in capsys.readouterr().err


def test_an_address_where_no_ray_is(monkeypatch):
    class Library:
        """Ray, as it answers there."""

        def is_initialized(self):
            return False

        def init(self, **options):
            raise ConnectionError(
                "Could not find any running Ray instance.\nPlease specify the one to connect to."
            )

    from gpcjax.sweep.executors import ray

    monkeypatch.setattr(ray, "_library", Library)
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(
        UserError, match=r"^address auto: no Ray .*\(Could not find any .* connect to\.\): start one"
    ):
        _ = Ray("auto").jobs
    assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.parametrize("port", ["\u00b2", "9" * 5000, "99999"])
def test_a_port_that_is_none_is_one_line(port):
    with pytest.raises(
        UserError, match=f"^address 127.0.0.1:{port}: no Ray that this machine belongs to is there"
    ):
        Ray(f"127.0.0.1:{port}")._connect()


def test_an_address_where_nobody_listens_is_told_at_once():
    """Ray itself would ask for many minutes."""
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))  # taken, and not listening
        address = f"127.0.0.1:{closed.getsockname()[1]}"
        with pytest.raises(
            UserError, match=f"address {address}: no Ray that this machine belongs to is there"
        ):
            Ray(address)._connect()
