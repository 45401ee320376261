"""Exported files act as the policy does, to 1e-9, whatever acts there: Python with numpy, C, ONNX."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gpcjax
from gpcjax import cli
from gpcjax.deploy.export import chosen_of, export
from gpcjax.deploy.label import identifier
from gpcjax.policies.base import Controller, Policy
from gpcjax.policies.plain import PlainKernel, PlainNetwork
from gpcjax.policies.saved import load_shipped, shipped_path
from tests.policies.made import draw, made

SHIPPED = ("cartpole", "pendulum", "pendulum-network", "brax-reacher")
HOSTILE = {
    "note": "*/ int x; /* ??/",
    "quotes": "\"\"\" ''' \\",
    "coding: latin-9": "é\u202e\n# second line",
    "long": "x" * 300 + "*/",
    "table": {"n": [1, 2.5, None]},
}


def policies():
    """By name: each kind, and what is shipped."""
    named = {f"{type(plain).__name__}_{number}": Policy.of(plain) for number, plain in enumerate(made())}
    extremes = np.array([[5e-324, -1.7976931348623157e308, 1 / 3], [-0.0, 1e-17, 123456789.0]])
    named["extremes"] = Policy.of(PlainNetwork((extremes,), (np.array([0.1, -0.2]),)))
    named["one_of_each"] = Policy.of(PlainKernel(np.ones((1, 1, 1)), np.ones((1, 1)), np.ones((1, 1)), 2.5))
    return named | {identifier(name): load_shipped(name) for name in SHIPPED}


POLICIES = policies()


def observations(size):
    """Near and far, and what is no number."""
    scales = (0.0, 0.01, 0.1, 1.0, 1.0, 30.0, 1e3, 1e200)
    drawn = [scale * draw(size, seed) for seed, scale in enumerate(scales)]
    for worst in (np.nan, np.inf, -np.inf):
        drawn.append(np.where(np.arange(size) == size // 2, worst, 0.1))
    drawn.append(np.where(np.arange(size) % 2 == 0, 1.7e308, -np.inf))
    return np.stack(drawn)


def expected(policy):
    return np.stack([policy(obs) for obs in observations(policy.plain.obs_size)])


def assert_same(found, policy):
    is_nan = np.isnan(observations(policy.plain.obs_size)).any(1)
    np.testing.assert_array_equal(np.isnan(found).any(1), is_nan)
    np.testing.assert_allclose(found, expected(policy), rtol=0, atol=1e-9, equal_nan=True)


def written(path, policy, provenance=None):
    """Exported as something from the cart-pole would be."""
    chosen = chosen_of(policy)._replace(env="cartpole", provenance=provenance or {})
    return export(chosen, path, None, None).file


@pytest.mark.parametrize("name", POLICIES)
def test_python(name, tmp_path):
    policy, names = POLICIES[name], {}
    text = written(tmp_path / f"{name}.py", policy, HOSTILE).read_text("ascii")
    exec(compile(text, name, "exec"), names)
    sizes = policy.plain.obs_size, policy.plain.action_size
    assert (names["OBS_SIZE"], names["ACTION_SIZE"]) == sizes
    act = names["act"]
    assert_same(np.stack([act(obs) for obs in observations(sizes[0])]), policy)
    found = act([0.1] * sizes[0])
    assert found.dtype == np.float64 and found.shape == (sizes[1],)
    for wrong in ([0.1] * (sizes[0] + 1), 0.1, [[0.1]] * sizes[0]):
        with pytest.raises(ValueError, match=rf"this policy takes \({sizes[0]},\)"):
            act(wrong)
    assert max(map(len, text.splitlines())) <= 110


def test_the_file_of_python_needs_numpy_alone(tmp_path):
    """And no jax is loaded to write it."""
    root, out = Path(gpcjax.__file__).parents[1], tmp_path / "swing.py"
    writing = f"import gpcjax, sys; gpcjax.export_policy({str(shipped_path('pendulum'))!r}, {str(out)!r})"
    acting = "import swing, sys; print(repr(float(swing.act([0.5, 0.5, 0.1])[0])))"
    printed = []
    for code, folder in ((writing, root), (acting, tmp_path)):
        loaded = "print({'gpcjax', 'jax', 'scipy', 'pandas', 'matplotlib'} & set(sys.modules))"
        done = subprocess.run(
            [sys.executable, "-c", f"{code}; {loaded}"], capture_output=True, text=True, cwd=folder
        )
        assert done.returncode == 0, done.stderr
        printed += done.stdout.splitlines()
    assert (printed[0], printed[2]) == ("{'gpcjax'}", "set()")
    assert abs(float(printed[1]) - load_shipped("pendulum")([0.5, 0.5, 0.1])[0]) < 1e-9


MAIN = """
#include <stdio.h>
{includes}
int main(void)
{{
    static double obs[64], action[64];
    int which, size, i;
    while (scanf("%d %d", &which, &size) == 2) {{
        for (i = 0; i < size; i++) {{
            if (scanf("%lf", &obs[i]) != 1) {{
                return 1;
            }}
        }}
        switch (which) {{
{cases}
        }}
        printf("\\n");
    }}
    return 0;
}}
"""

CASE = """        case {number}:
            {name}_act(obs, action);
            for (i = 0; i < {upper}_ACTION_SIZE; i++) {{
                printf("%.17g ", action[i]);
            }}
            if (size != {upper}_OBS_SIZE) {{
                return 2;
            }}
            break;
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """A folder with all headers, one of them included twice, and a program that asks each."""
    folder = tmp_path_factory.mktemp("c")
    names = [written(folder / f"{name}.h", policy, HOSTILE).stem for name, policy in POLICIES.items()]
    includes = "\n".join(f'#include "{name}.h"' for name in [*names, names[0]])
    cases = "".join(
        CASE.format(number=number, name=name, upper=name.upper()) for number, name in enumerate(names)
    )
    (folder / "main.c").write_text(MAIN.format(includes=includes, cases=cases))
    return folder


@pytest.mark.parametrize(
    ("compiler", "words"),
    [("cc", ["-std=c99"]), ("c++", ["-x", "c++", "-std=c++11"])],
    ids=["C99", "C++"],
)
def test_c(compiler, words, program):
    if shutil.which(compiler) is None:
        pytest.skip(f"no compiler is called {compiler} here")
    strict = ["-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror", "-O1"]
    out = program / compiler.replace("+", "x")
    done = subprocess.run(
        [compiler, *words, *strict, "main.c", "-o", str(out), "-lm"],
        capture_output=True,
        text=True,
        cwd=program,
    )
    assert (done.returncode, done.stderr) == (0, "")
    lines = [
        f"{number} {len(obs)} {' '.join(map(repr, obs.tolist()))}"
        for number, policy in enumerate(POLICIES.values())
        for obs in observations(policy.plain.obs_size)
    ]
    ran = subprocess.run([str(out)], input="\n".join(lines), capture_output=True, text=True)
    assert ran.returncode == 0
    found = [np.array(line.split(), float) for line in ran.stdout.splitlines()]
    assert len(found) == len(lines)
    for policy in POLICIES.values():
        count = len(expected(policy))
        assert_same(np.stack(found[:count]), policy)
        found = found[count:]


def test_a_header_says_what_it_is(tmp_path):
    path = written(tmp_path / "9 lives!.h", load_shipped("cartpole"), {"teacher": "Ada", "seed": 3})
    text = path.read_text("ascii")
    assert "void policy_9_lives_act(const double *obs, double *action)" in text
    head = text.partition("*/")[0]
    for word in (
        f"Exported by gpcjax {gpcjax.__version__}",
        "Matern 1.5",
        "28 points",
        "obs[2]: angle (rad)",
        "action[0]: from -1 to 1; less is push left, more is push right",
        "one action each 0.02 s",
        "env: cartpole",
        "teacher: Ada",
        "seed: 3",
    ):
        assert word in head, word
    assert "#ifndef GPCJAX_POLICY_POLICY_9_LIVES_H\n" in text and "malloc" not in text
    assert re.findall("#include .*", text) == ["#include <math.h>"]


@pytest.mark.parametrize("runtime", ["reference", "onnxruntime"])
def test_onnx(runtime, tmp_path):
    onnx = pytest.importorskip("onnx", reason="onnx is not installed")
    if runtime == "onnxruntime":
        pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    for name, policy in POLICIES.items():
        file = written(tmp_path / f"{name}.onnx", policy, HOSTILE)
        obs = observations(policy.plain.obs_size)
        with np.errstate(all="ignore"):
            (found,) = _session(runtime, file).run(None, {"obs": obs})
            (alone,) = _session(runtime, file).run(None, {"obs": obs[3:4]})
        assert found.dtype == np.float64
        assert_same(found, policy)
        np.testing.assert_allclose(alone, expected(policy)[3:4], rtol=0, atol=1e-9)
        model = onnx.load(file)
        assert (model.producer_name, model.producer_version) == ("gpcjax", gpcjax.__version__)
        assert "env: cartpole" in model.doc_string and file.read_bytes() == model.SerializeToString(
            deterministic=True
        )


def _session(runtime, file):
    if runtime == "reference":
        from onnx.reference import ReferenceEvaluator

        return ReferenceEvaluator(str(file))
    from onnxruntime import InferenceSession

    return InferenceSession(str(file), providers=["CPUExecutionProvider"])


def test_without_onnx_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"^--to onnx needs its extra: pip install 'gpcjax\[onnx\]'$"):
        gpcjax.export_policy(POLICIES["extremes"], tmp_path / "x.onnx")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".py", ".h", ".onnx"])
def test_the_same_policy_is_the_same_file(suffix, tmp_path):
    if suffix == ".onnx":
        pytest.importorskip("onnx", reason="onnx is not installed")
    once, again = (
        gpcjax.export_policy(shipped_path("pendulum"), tmp_path / name / f"a{suffix}").read_bytes()
        for name in ("first", "second")
    )
    assert once == again
    other = gpcjax.export_policy(shipped_path("cartpole"), tmp_path / "first" / f"a{suffix}")
    assert other.read_bytes() != once and [each.name for each in other.parent.iterdir()] == [other.name]


def test_unused_points_stay_here(tmp_path):
    """A learner has room for more points than it holds."""
    used = np.arange(8) < [[3], [2]]
    plain = PlainKernel(draw((2, 8, 3)), draw((2, 8)) * used, np.ones((2, 3)), 1.5)
    policy, names = Policy.of(plain), {}
    exec(gpcjax.export_policy(policy, tmp_path / "taught.py").read_text(), names)
    assert names["POINTS"].shape == (2, 3, 3)
    assert_same(np.stack([names["act"](obs) for obs in observations(3)]), policy)


class Halved(Controller):
    obs_size = action_size = 2

    def __call__(self, obs):
        return 0.5 * obs


@pytest.mark.parametrize(
    ("policy", "out", "to", "name", "message"),
    [
        (Policy(Halved()), "x.py", None, None, "this policy: it cannot be exported, it is code of its own"),
        ("cartpole:lqr", "x.h", None, None, "expert lqr: it cannot be exported, it is code of its own"),
        ("nowhere", "x.h", None, None, "nowhere: there is no such folder"),
        (3, "x.h", None, None, "policy 3: give a policy, or the path of one"),
        ("", "x.h", None, None, "policy '': give a path"),
        ("SHIPPED", "x.txt", None, None, "out x.txt: give a path that ends in .py, .h or .onnx, or a format"),
        ("SHIPPED", "x.py", "c", None, "out x.py: give a path that ends in .h, for c"),
        ("SHIPPED", "x.py", "java", None, "to 'java': give python, c or onnx"),
        ("SHIPPED", "x.h", None, "2fast", "name '2fast': give an identifier of Python and C"),
        ("SHIPPED", "x.h", None, "é", "name 'é': give an identifier of Python and C"),
        ("SHIPPED", "/proc/none/x.h", None, None, "/proc/none/x.h: it cannot be written there"),
        ("SHIPPED", 3, None, None, "out 3: give a path"),
        (
            "INFINITE",
            "x.py",
            None,
            None,
            "this policy: it cannot be exported, its numbers are not all finite",
        ),
    ],
)
def test_what_cannot_be_exported_says_so(policy, out, to, name, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if policy == "SHIPPED":
        policy = shipped_path("cartpole")
    if policy == "INFINITE":
        policy = Policy.of(PlainNetwork((np.full((1, 1), np.inf),), (np.zeros(1),)))
    with pytest.raises(ValueError, match=f"^{re.escape(message)}") as raised:
        gpcjax.export_policy(policy, out, to, name)
    assert "\n" not in str(raised.value) and not list(tmp_path.iterdir())


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gpcjax.deploy.command.compute_here", lambda: None)
    assert cli.main(["policy", "export", "pendulum:gpc", "--to", "c"]) == 0
    size = Path("runs/pendulum_gpc.h").stat().st_size
    told = f"runs/pendulum_gpc.h: void pendulum_gpc_act(const double *obs, double *action); {size:,} bytes\n"
    assert capsys.readouterr().out == told
    assert cli.main(["policy", "export", "pendulum:gpc", "--out", "b.h", "--name", "swing", "--json"]) == 0
    assert capsys.readouterr().out.startswith(
        '{"file": "b.h", "to": "c", "name": "swing", "call": "void swing_act'
    )
    for words, line in (
        ([], "--to is missing: give python, c or onnx"),
        (["--to", "rust"], "--to 'rust': give python, c or onnx"),
        (["--out", "b.txt"], "--out b.txt: give a path that ends in .py, .h or .onnx, or a format"),
        (["--out", "b.h", "--name", "a-b"], "name 'a-b': give an identifier of Python and C"),
    ):
        assert cli.main(["policy", "export", "pendulum:gpc", *words]) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"gpcjax: error: {line}") and said.count("\n") == 1
