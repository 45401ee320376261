"""Every test runs with checks on: shapes and types at run time, random keys used once, no silent broadcasting."""

import contextlib
import ctypes
import gc
import os
import signal
import sys
import threading
import warnings

import hypothesis
import jax
import pytest
import threadpoolctl
from jax._src import compiler
from jax._src.interpreters import mlir
from jaxtyping import install_import_hook

from gpcjax.sweep.environment import xla_options
from tests import typechecker

pytest_plugins = ["tests.tiers", "tests.memory"]

COMPUTING = (
    "gpcjax.elementary gpcjax.engine gpcjax.envs gpcjax.gp gpcjax.learners gpcjax.moment gpcjax.policies"
    " gpcjax.streams gpcjax.sweep.ppo gpcjax.teachers"
).split()
"""Whose shapes and types are checked at run time, where `typechecker.CHECKED` says so.

The static checker looks after all others.

A nested function is decorated anew at each call, which takes most of the time of what draws figures and writes pages.
"""

install_import_hook(COMPUTING, "tests.typechecker.check")

# All processes of the tests read the same modules: what they compile these to is kept, whatever the environment says.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# No power fails under tests: nobody waits until the disk has what is written.
os.fsync = lambda descriptor: None

# A shell's background job ignores Ctrl-C, and nohup a lost connection; so would all that the tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# The types of this extension warn while it is loaded, which crashes the process where warnings are errors.
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import Box2D  # noqa: F401

# Matrices of tests are small: a second thread of BLAS waits more than it computes.
threadpoolctl.threadpool_limits(1, "blas")

jax.config.update("jax_numpy_rank_promotion", "raise")

# Nobody reads where in the source each operation of a program comes from: it is traced and lowered in less time.
jax.config.update("jax_traceback_in_locations_limit", 0)

# The same examples in every run: what is covered is no matter of luck.
hypothesis.settings.register_profile("gpcjax", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("gpcjax")


DRAWING = (
    "engine/test_evaluate.py",
    "engine/test_foreign.py",
    "engine/test_session.py",
    "engine/test_streams.py",
    "envs/",
    "learners/test_dcoach.py",
    "policies/test_network.py",
    "sweep/test_ppo.py",
    "teachers/",
    "test_public.py",
    "test_streams.py",
)
"""Modules that draw: there no random key is used twice. Looking after them makes each call of a program a millisecond
longer; programs that are compiled ahead, as a pool's, are never looked at.
"""

COMPILED_PLAINLY = (
    "deploy/",
    "engine/test_classroom.py",
    "engine/test_evaluate.py",
    "engine/test_host.py",
    "engine/test_keeping.py",
    "engine/test_late.py",
    "engine/test_planner.py",
    "engine/test_together.py",
    "engine/test_rollout.py",
    "engine/test_schedule.py",
    "engine/test_session.py",
    "engine/test_streams.py",
    "engine/test_taught.py",
    "envs/test_brax",
    "envs/test_cartpole.py",
    "envs/test_env_registry.py",
    "envs/test_experts.py",
    "envs/test_foreign_tasks.py",
    "envs/test_lanes.py",
    "envs/test_mountaincar.py",
    "envs/test_pendulum.py",
    "envs/test_predictive.py",
    "gp/test_factor.py",
    "gp/test_fit.py",
    "gp/test_kernels.py",
    "gp/test_likelihood.py",
    "gp/test_regression.py",
    "learners/test_calls.py",
    "learners/test_carried.py",
    "learners/test_coach.py",
    "learners/test_dcoach.py",
    "learners/test_gpc.py",
    "learners/test_own.py",
    "learners/test_parity.py",
    "learners/test_recipes.py",
    "learners/test_saved.py",
    "learners/test_scaling.py",
    "policies/",
    "reproduce/test_illustrations.py",
    "study/",
    "sweep/test_lander.py",
    "sweep/test_own_settings.py",
    "sweep/test_ppo.py",
    "sweep/test_schedule.py",
    "sweep/test_start.py",
    "sweep/test_sweeps.py",
    "teach/test_browser.py",
    "teach/test_from.py",
    "teach/test_lesson.py",
    "teach/test_taught.py",
    "teachers/",
    "tune/test_likelihood.py",
    "docs/",
    "test_foreign.py",
    "test_pickle.py",
    "test_play.py",
    "test_public.py",
    "test_settings.py",
)
"""Modules for which XLA need not do its best: what they say is about numbers within a tolerance, or about the bits of
one program. It compiles in half of the time. Others look at programs, compare bits of several, or loop long.
"""

LONGEST = (
    "teach/test_browser.py",
    "docs/test_snippets.py",
    "learners/test_gpc.py",
    "engine/test_keeping.py",
    "engine/test_pool.py",
    "tune/test_tuning.py",
    "study/test_hall.py",
    "sweep/test_sweeps.py",
    "sweep/test_underway.py",
    "engine/test_session.py",
    "test_settings.py",
    "engine/test_evaluate.py",
    "teach/test_lesson.py",
    "study/test_report.py",
    "reproduce/test_run.py",
    "reproduce/test_claims.py",
    "gp/test_likelihood.py",
    "tune/test_likelihood.py",
    "sweep/test_inprocess.py",
    "engine/test_cost.py",
    "engine/test_classroom.py",
    "reproduce/test_illustrations.py",
    "gp/test_regression.py",
    "learners/test_calls.py",
    "learners/test_carried.py",
    "test_foreign.py",
    "test_torture.py",
    "sweep/test_executables.py",
    "learners/test_parity.py",
    "learners/test_saved.py",
    "gp/test_factor.py",
    "gp/test_fit.py",
    "report/test_compare.py",
    "report/test_run.py",
    "engine/test_host.py",
    "engine/test_host_pool.py",
    "engine/test_late.py",
    "engine/test_rollout.py",
    "engine/test_together.py",
    "sweep/test_start.py",
    "teach/test_from.py",
    "teach/test_taught.py",
    "study/test_server.py",
    "deploy/test_commands.py",
    "envs/test_brax_experts.py",
    "cluster/test_remote.py",
    "test_makefile.py",
    "test_stopping.py",
)
"""Modules that begin first: one that came last would keep one process at work while the others have nothing to do."""


def pytest_collection_modifyitems(items):
    """The longest first, and together what is compiled alike: between others all that was compiled is forgotten."""
    places = {name: place for place, name in enumerate(LONGEST)}

    def place(item):
        name = item.nodeid.partition("::")[0].removeprefix("tests/")
        plainly, last = name.startswith(COMPILED_PLAINLY), len(LONGEST)
        first = places.get(name, last)
        return plainly if first < last else 3 - plainly, first

    items.sort(key=place)


def pytest_collection_finish():
    """What all modules loaded stays to the end: who collects garbage need not look at its half a million objects."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def compiled_programs(tmp_path_factory):
    """What is compiled is kept for this run of the tests, and none of an earlier one is used.

    By the workers of real sweeps, and by the tests themselves: most modules need the same small programs.
    """
    shared = tmp_path_factory.getbasetemp()
    shared = str((shared.parent if "PYTEST_XDIST_WORKER" in os.environ else shared) / "xla")
    jax.config.update("jax_compilation_cache_dir", shared)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAX_COMPILATION_CACHE_DIR", shared)
        yield


@pytest.fixture(scope="module", autouse=True)
def environment_of_others():
    """What a module leaves in the environment, as a command does that computes in its own process, ends with it."""
    before = dict(os.environ)
    yield
    for name in os.environ.keys() - before.keys():
        del os.environ[name]
    os.environ.update(before)


@pytest.fixture(scope="module", autouse=True)
def settings_of_jax(request):
    """Those that this module needs."""
    name = request.node.nodeid.removeprefix("tests/")
    jax.config.update("jax_debug_key_reuse", name.startswith(DRAWING))
    typechecker.check_in(name, everywhere=request.config.option.both_tiers)
    _compile(plainly=name.startswith(COMPILED_PLAINLY))


@contextlib.contextmanager
def _compiled(plainly):
    """With or without `QUICKLY` until the end."""
    before = jax.config.values["jax_disable_most_optimizations"]
    _compile(plainly)
    yield
    _compile(before)


def _compile(plainly):
    """From now on; what was compiled otherwise is forgotten."""
    if plainly != jax.config.values["jax_disable_most_optimizations"]:
        jax.clear_caches()
        if (classroom := sys.modules.get("gpcjax.engine.classroom")) is not None:
            classroom._programs.cache_clear()  # which are compiled ahead: jax knows nothing of them
        jax.config.update("jax_disable_most_optimizations", plainly)


QUICKLY = (
    {"xla_cpu_use_fusion_emitters": False, "xla_cpu_parallel_codegen_split_count": 1} if xla_options() else {}
)
"""What XLA is told beside, where its version is one that knows it: its older emitter needs two fifths of the time."""

_options_of = compiler.get_compile_options


def _options_as_wanted(*given, env_options_overrides=None, **named):
    """jax has a setting for the other options of `jax_disable_most_optimizations`, and none for these."""
    wanted = QUICKLY if jax.config.values["jax_disable_most_optimizations"] else {}
    return _options_of(*given, env_options_overrides={**wanted, **(env_options_overrides or {})}, **named)


compiler.get_compile_options = _options_as_wanted


class _Contexts(threading.local):
    """What programs are lowered in: making one takes longer than lowering a small program in it.

    What programs hold stays in it, so that it is made anew from time to time.
    """

    lowered = 0

    def __call__(self):
        if self.lowered % 100 == 0:
            self.context = _new_context()
        self.lowered += 1
        return self.context


_new_context = mlir.make_ir_context
mlir.make_ir_context = _Contexts()


@pytest.fixture
def compiled_as_shipped():
    """XLA does its best for this test, whatever its module wants: it compares the bits of two programs."""
    with _compiled(plainly=False):
        yield


@pytest.fixture(scope="class")
def class_compiled_as_shipped():
    """The same for all tests of a class, and for what they share."""
    with _compiled(plainly=False):
        yield


@pytest.fixture
def compiled_plainly():
    """XLA need not do its best for this test, whatever its module wants."""
    with _compiled(plainly=True):
        yield


@pytest.fixture(scope="module")
def workers_in_process(settings_of_jax):
    """Sweeps of this module that are to run in processes run here: no worker has to start, where that is not tested."""
    from gpcjax.sweep import run, worker
    from gpcjax.sweep.executors import InProcess

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "Processes", lambda jobs: InProcess())
        patch.setattr(worker, "give_back_memory", lambda: None)
        yield


@pytest.fixture(scope="module")
def figures_unpainted():
    """Every figure of this module is made, none is painted: that takes seconds, and the tests of reports do it."""
    from gpcjax.report.figures import style

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "image", lambda figure, kind: kind.encode())
        yield


@pytest.fixture(autouse=True)
def what_is_held_is_given_back():
    """Where so much is held that the next tests would go beyond what is allowed."""
    yield
    Held.keep_below()


LARGE, MORE = 1.1e9, 0.1e9
"""Bytes up to which nothing is given back: at all, and more than were left the last time."""


class Held:
    """How much of its memory this process gives back, and when."""

    limit = LARGE

    @classmethod
    def keep_below(cls):
        """Garbage goes first, and compiled programs if that was not enough: tests that follow use them, too."""
        if _held() > cls.limit:
            _give_back()
            if _held() > cls.limit:
                jax.clear_caches()
                _give_back()
                cls.limit = max(LARGE, _held() + MORE)


def _held():
    """Bytes that this process holds now; 0 where the system does not say it."""
    try:
        with open("/proc/self/statm") as told:
            return int(told.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def _give_back():
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc alone has it
    if trim is not None:
        trim(0)
