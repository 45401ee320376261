"""What an import loads, seen from fresh processes: our own has loaded everything."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import gpcjax

ROOT = Path(gpcjax.__file__).parents[1]
HEAVY = {
    *("jax", "jaxlib", "equinox", "jaxtyping", "numpy", "scipy", "pandas", "pyarrow"),
    *("brax", "mujoco", "gymnasium", "orbax", "optax", "matplotlib", "rich", "sklearn"),
}


def first_heavy(steps):
    """The first of these statements after which a fresh process has something heavy, and what; None if none has."""
    code = f"""
import json, sys
for step in {steps!r}:
    try:
        exec(step)
    except SystemExit:
        pass
    found = sorted({HEAVY!r} & {{name.partition('.')[0] for name in sys.modules}})
    if found:
        break
print(json.dumps([step, found] if found else None))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return json.loads(done.stdout.splitlines()[-1])


def test_importing_loads_nothing_heavy():
    steps = [
        "import gpcjax",
        "dir(gpcjax); gpcjax.__version__; hasattr(gpcjax, 'nothing')",
        "import gpcjax.cli, gpcjax.sweep.plan, gpcjax.sweep.runfolder, gpcjax.envs.tasks, gpcjax.learners.descriptions",
    ]
    assert first_heavy(steps) is None
    assert first_heavy([*steps, "import numpy"]) == ["import numpy", ["numpy"]]


COMMANDS = [
    ["--help"],
    ["sweep", "--help"],
    ["grid", "--help"],
    ["reproduce", "--help"],
    ["reproduce", "--dry-run", "--out", "/tmp/there-is-none"],
    ["reproduce", "--only", "foo"],
    ["policy", "export", "--help"],
    ["policy", "export", "cartpole:gpc", "--to", "java"],
    ["version"],
    ["sweep", "--env", "cartpole", "--dry-run", "--out", "/tmp/there-is-none"],
    ["sweep", "--env", "foo"],
    ["sweep", "sweeps/none.toml"],
    ["report", "/tmp/there-is-none"],
    ["compare", "/tmp/there-is-none", "/tmp/nor-this"],
]


def test_the_command_line_loads_nothing_heavy_until_something_runs():
    """One after the other in one process."""
    assert first_heavy(["from gpcjax.cli import main", *(f"main({words!r})" for words in COMMANDS)]) is None


@pytest.mark.slow
@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_nor_does_one_alone(words):
    assert first_heavy(["from gpcjax.cli import main", f"main({words!r})"]) is None


FIRST = """
import sys
def has(*names): return {*names} & {name.partition(".")[0] for name in sys.modules}
import gpcjax
gpcjax.make_learner
import jax
from jax._src import xla_bridge
assert jax.config.jax_enable_x64 and not xla_bridge.backends_are_initialized()
assert not has("brax", "gymnasium", "matplotlib", "pandas")
"""
TASKS = """
import gpcjax.envs.brax_adapter, gpcjax.envs.host
from gpcjax.envs.registry import make_env, make_expert
make_env("cartpole"), make_expert("cartpole", "lqr"), make_env("pendulum"), make_expert("lunarlander", "heuristic")
assert not has("brax", "gymnasium", "matplotlib")
print(jax.numpy.zeros(1).dtype)
"""


@pytest.mark.parametrize(
    "word", ["0", *(pytest.param(word, marks=pytest.mark.slow) for word in ("", "false"))]
)
def test_the_first_name_switches_to_float64_and_starts_no_backend(word):
    """Over the environment, and then it is said; tasks load neither brax nor gymnasium."""
    done = subprocess.run(
        [sys.executable, "-c", FIRST + TASKS],
        cwd=ROOT,
        env={**os.environ, **({"JAX_ENABLE_X64": word} if word else {})},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "float64\n"
    said = "JAX_ENABLE_X64 is off, but gpcjax needs float64: it is switched on"
    assert (said in done.stderr) == bool(word)


def test_public_names():
    assert len(set(gpcjax.__all__)) == len(gpcjax.__all__)
    assert set(gpcjax.__all__) == set(gpcjax._PUBLIC)
    assert set(gpcjax.__all__) <= set(dir(gpcjax))


@pytest.mark.parametrize("name", gpcjax.__all__)
def test_a_public_name_is_a_documented_function(name):
    function = getattr(gpcjax, name)
    assert function is getattr(gpcjax, name)
    assert function.__doc__


def test_no_public_name_is_hidden_by_a_subpackage():
    packages = {path.name.removesuffix(".py") for path in (ROOT / "gpcjax").iterdir()}
    assert not packages & set(gpcjax.__all__)


def test_an_unknown_name():
    with pytest.raises(AttributeError, match="module 'gpcjax' has no attribute 'nothing'"):
        gpcjax.nothing  # noqa: B018
