"""Programs that are kept whole: the same bits without compiling, and nothing but what this user wrote is executed."""

import contextlib
import errno
import fcntl
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax import make_env, make_expert, make_learner, make_oracle
from gpcjax.engine.lanes import Start
from gpcjax.engine.pool import Finished, Pool, Tier
from gpcjax.sweep import executables
from gpcjax.sweep.executables import Executables

KEY = "0" * 32
NARROW = Tier(1, 1, 8)


def lowered(factor=2):
    def flat(leaves, given):
        return [leaves[0] + given[0], leaves[1] * factor], [given[0] * 3]

    leaves, given = [jnp.arange(3.0), jnp.ones(2)], [np.float64(4.0)]
    return jax.jit(flat, donate_argnums=0, keep_unused=True).lower(leaves, given)


def keep(folder, key=KEY, factor=2):
    return Executables(folder).compiled(key, lowered(factor), 2, 1, 1)


def program(folder):
    (path,) = folder.glob("*.program")
    return path


def result(program):
    leaves, others = program([jnp.arange(3.0), jnp.ones(2)], [np.float64(4.0)])
    return [leaf.tolist() for leaf in (*leaves, *others)]


@pytest.fixture
def folder(tmp_path):
    keep(tmp_path / "programs")
    return tmp_path / "programs"


def test_what_was_kept_computes_the_same(folder):
    found = Executables(folder).find(KEY)
    assert found is not None
    assert result(found) == result(lowered().compile()) == [[4.0, 5.0, 6.0], [2.0, 2.0], 12.0]
    assert Executables(folder).find("1" * 32) is None


class Compiling:
    """A program that is lowered and takes its time to compile."""

    def __init__(self, compile=None):
        self._lowered, self._compile = lowered(), compile
        self.compiled = 0

    def as_text(self):
        return self._lowered.as_text()

    def compile(self):
        self.compiled += 1
        if self._compile is not None:
            self._compile()
        return self._lowered.compile()


def test_what_another_one_compiles_is_waited_for_and_read(tmp_path, monkeypatch):
    begun, waited = threading.Event(), threading.Event()

    def compile():
        begun.set()
        assert waited.wait(60)

    def sleep(seconds):
        waited.set()
        begun.wait(seconds)

    monkeypatch.setattr(executables.time, "sleep", sleep)
    first, second = Compiling(compile), Compiling()
    one = threading.Thread(target=Executables(tmp_path).compiled, args=(KEY, first, 2, 1, 1))
    one.start()
    assert begun.wait(60)
    found = Executables(tmp_path).compiled("1" * 32, second, 2, 1, 1)
    one.join(60)
    assert (first.compiled, second.compiled) == (1, 0)
    assert result(found) == [[4.0, 5.0, 6.0], [2.0, 2.0], 12.0]
    assert sorted({path.suffix for path in tmp_path.iterdir()}) == [".key", ".program"]


@pytest.mark.parametrize("held", [True, False])
def test_who_cannot_have_the_lock_compiles_alone(tmp_path, monkeypatch, held):
    """One that hangs, or was stopped, holds it; a file system may have none."""
    monkeypatch.setattr(executables, "MOST_SECONDS", 0.0)

    def refuse(descriptor, how):
        raise BlockingIOError if held else OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(executables.fcntl, "flock", refuse)
    monkeypatch.setattr(executables.time, "sleep", lambda seconds: None)
    program = Compiling()
    assert result(Executables(tmp_path).compiled(KEY, program, 2, 1, 1))[2] == 12.0
    assert program.compiled == 1


@contextlib.contextmanager
def held(folder):
    """Somebody compiles the program, and goes on with it until the end; gives the lock's file."""
    text = program(folder).stem
    program(folder).unlink()
    path = folder / f"{text}.lock"
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        yield path
    finally:
        os.close(descriptor)


def test_those_who_waited_read_at_the_same_time(folder, monkeypatch):
    """A program takes a third of a second to read: one after the other, of 64, is longer than to compile it."""
    kept, barrier, read = program(folder).read_bytes(), threading.Barrier(3), Executables._read
    sleeping, sleep = threading.Semaphore(0), time.sleep

    def together(self, text):
        found = read(self, text)
        if found is not None:
            barrier.wait(60)
        return found

    def awaits(seconds):
        sleeping.release()
        sleep(seconds)

    monkeypatch.setattr(Executables, "_read", together)
    monkeypatch.setattr(executables.time, "sleep", awaits)
    with ThreadPoolExecutor(3) as threads:
        with held(folder) as path:
            waiting = [threads.submit(keep, folder, str(n) * 32) for n in range(3)]
            for _ in range(3):
                assert sleeping.acquire(timeout=60)
            path.with_suffix(".program").write_bytes(kept)
            path.with_suffix(".program").chmod(0o600)
        assert all(result(each.result(60))[2] == 12.0 for each in waiting)


def test_where_nothing_is_kept_nobody_waits_for_more_than_the_first(tmp_path, monkeypatch):
    """All compile at the same time then, as if each were alone."""
    barrier, begun = threading.Barrier(2), threading.Event()

    def first():
        begun.set()
        time.sleep(0.2)

    def full(*_):
        raise OSError(errno.EDQUOT, "Disk quota exceeded")

    monkeypatch.setattr(executables, "write_atomic", full)
    programs = [Compiling(first), *(Compiling(lambda: barrier.wait(60)) for _ in range(2))]
    with ThreadPoolExecutor(3) as threads:
        done = [threads.submit(Executables(tmp_path).compiled, KEY, programs[0], 2, 1, 1)]
        assert begun.wait(60)
        done += [threads.submit(Executables(tmp_path).compiled, KEY, each, 2, 1, 1) for each in programs[1:]]
        assert all(result(each.result(60))[2] == 12.0 for each in done)
    assert [each.compiled for each in programs] == [1, 1, 1]


def test_a_signal_ends_the_wait_and_the_lock_stays_with_who_has_it(folder, monkeypatch):
    def stopped():
        raise KeyboardInterrupt

    with held(folder) as path:
        monkeypatch.setattr(executables.stopping, "check", stopped)
        with pytest.raises(KeyboardInterrupt):
            keep(folder)
        monkeypatch.undo()
        monkeypatch.setattr(executables, "MOST_SECONDS", 0.0)
        assert result(keep(folder))[2] == 12.0
        assert path.exists()


def test_what_is_compiled_in_a_hurry_is_not_for_others(folder):
    """Such a program has other bits, and they would be taken for those of a worker."""
    jax.config.update("jax_disable_most_optimizations", True)
    try:
        assert Executables(folder).find(KEY) is None
        keep(folder, "1" * 32, factor=3)
    finally:
        jax.config.update("jax_disable_most_optimizations", False)
    assert len(list(folder.glob("*.program"))) == 1
    assert Executables(folder).find("1" * 32) is None and Executables(folder).find(KEY) is not None


def test_only_the_user_can_write_there(folder):
    path = program(folder)
    assert [folder.stat().st_mode & 0o777, path.stat().st_mode & 0o777] == [0o700, 0o600]
    for spoiled in (path, folder / f"{KEY}.key", folder):
        for mode in (0o620, 0o602, 0o722):
            spoiled.chmod(mode | 0o100)
            assert Executables(folder).find(KEY) is None
        spoiled.chmod(0o700)
    assert Executables(folder).find(KEY) is not None


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_what_another_user_wrote_is_not_executed(folder):
    os.chown(program(folder), 12345, -1)
    assert Executables(folder).find(KEY) is None


def test_what_is_not_whole_is_compiled_anew(folder):
    path = program(folder)
    whole = path.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
    for spoiled in (b"", whole[:10], whole[:-1], whole + b"x", flipped, b"x" * len(whole)):
        path.write_bytes(spoiled)
        assert Executables(folder).find(KEY) is None
    keep(folder)
    assert Executables(folder).find(KEY) is not None


def test_where_nothing_can_be_kept_nothing_is_said(tmp_path, capfd):
    (tmp_path / "file").write_text("")
    assert result(keep(tmp_path / "file"))[1] == [2.0, 2.0]
    assert Executables(tmp_path / "file").find(KEY) is None
    assert capfd.readouterr() == ("", "")


def test_what_was_not_used_for_longest_goes(folder, monkeypatch):
    size = sum(path.stat().st_size for path in folder.iterdir())
    monkeypatch.setattr(executables, "MOST_BYTES", 5 * size // 2)
    keep(folder, "1" * 32, factor=3)
    for path in folder.iterdir():
        os.utime(path, (path.stat().st_mtime - 20,) * 2)
    Executables(folder).find(KEY)  # used: the other one is older now
    keep(folder, "2" * 32, factor=4)
    found = [Executables(folder).find(name) for name in (KEY, "1" * 32, "2" * 32)]
    assert [each is not None for each in found] == [True, False, True]


def test_another_source_of_the_same_text_compiles_nothing(folder, monkeypatch):
    monkeypatch.setattr(executables, "_compiling_anew", None)  # which would be called
    assert result(keep(folder, "1" * 32)) == result(lowered().compile())
    assert Executables(folder).find("1" * 32) is not None
    assert len(list(folder.glob("*.program"))) == 1


@pytest.mark.slow
def test_what_xla_has_in_its_cache_is_kept_all_the_same(tmp_path):
    """A program from there can be run, but what is written of it cannot: in a process that never compiled it."""
    script = (
        "import sys, jax; from pathlib import Path; from tests.sweep.test_executables import *\n"
        "jax.config.update('jax_persistent_cache_min_compile_time_secs', 0.0)\n"
        "jax.config.update('jax_persistent_cache_min_entry_size_bytes', -1)\n"
        "lowered().compile()\n"
        "found = Executables(Path(sys.argv[1])).find(KEY)\n"
        "print(result(found or keep(Path(sys.argv[1]))), found is not None)\n"
    )
    environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "xla"), "PYTHONPATH": os.getcwd()}
    said = [
        subprocess.run(
            [sys.executable, "-c", script, str(tmp_path / f"programs{number}")],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for number in (0, 1, 1)
    ]
    assert list((tmp_path / "xla").iterdir())
    assert said == [f"[[4.0, 5.0, 6.0], [2.0, 2.0], 12.0] {found}\n" for found in (False, False, True)]


def solved(leaves, given):
    """With the factor of a matrix, which LAPACK computes."""
    factor = jax.lax.linalg.cholesky(leaves[0])
    return [jax.lax.linalg.triangular_solve(factor, given[0], left_side=True, lower=True)], []


def test_a_program_that_factorises_does_so_in_a_process_that_has_lowered_nothing(tmp_path):
    script = (
        "import sys, numpy as np; from pathlib import Path\n"
        "from gpcjax.sweep.executables import Executables\n"
        f"found, matrix = Executables(Path(sys.argv[1])).find({KEY!r}), np.eye(3) * 4.0\n"
        "print(np.asarray(found([matrix], [matrix])[0][0]).tolist())\n"
    )
    matrix = np.eye(3) * 4.0
    with jax.enable_x64(True):
        lowered = jax.jit(solved, keep_unused=True).lower([matrix], [matrix])
    Executables(tmp_path / "programs").compiled(KEY, lowered, 1, 1, 0)
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "programs")],
        env=os.environ | {"JAX_ENABLE_X64": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"it ended with {done.returncode}: {done.stderr}"
    assert done.stdout == f"{(np.eye(3) * 2.0).tolist()}\n"


def coach(episodes, kept=None):
    learner = make_learner("coach", "cartpole")
    start = Start(
        0, *jax.tree.map(np.asarray, (learner, make_oracle("cartpole", "lqr", rate=0.2).oracle)), seed=3
    )
    pool = Pool(make_env("cartpole"), make_expert("cartpole", "lqr"), episodes, start, (NARROW,), kept=kept)
    return pool, start


def finish(pool, start):
    waiting, finished = iter([start]), list[Finished]()
    pool.run(lambda: next(waiting, None), finished.append)
    return finished[0].lane


@pytest.mark.slow
def test_a_pool_compiles_nothing_that_was_kept_and_comes_to_the_same_bits(
    tmp_path, monkeypatch, compiled_plainly
):
    """For any number of episodes that there is room for; as a sweep does in test_sweeps.py."""
    monkeypatch.setattr(executables, "_IN_A_HURRY", "jax_disable_jit")  # these are for nobody else
    pool, start = coach(2, Executables(tmp_path))
    lane = finish(pool, start)
    assert pool.counters.compilations == 2
    again, start = coach(2, Executables(tmp_path))
    for one, other in zip(*map(jax.tree.leaves, (finish(again, start), lane)), strict=True):
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes()
    longer, start = coach(5, Executables(tmp_path))
    more = finish(longer, start)
    assert [again.counters.compilations, longer.counters.compilations] == [0, 0]
    assert more.rows.length.shape == (5,) and (more.rows.length > 0).all()
    for name, column in vars(lane.rows).items():
        if name != "own":
            assert np.asarray(column).tobytes() == np.asarray(getattr(more.rows, name))[:2].tobytes()
