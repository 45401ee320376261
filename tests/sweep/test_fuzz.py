"""Thousands of generated specifications, the same in every run: each is refused in one line, or is what was written.

What is allowed is told here a second time, by hand and without the table of options, so that a slip in the table
or in the reading of a number does not pass for both.
"""

import contextlib
import io
import math
import random
import re
from pathlib import Path

import pytest

from gpcjax import cli
from gpcjax.sweep.spec import SweepSpec
from gpcjax.sweep.tomlfile import LARGEST_FILE

COUNTS = [400, pytest.param(2000, marks=pytest.mark.slow)]
"""Specifications of each kind, flags and TOML."""

ENVS = ("cartpole", "pendulum", "lunarlander", "mountaincar")
EXPERTS = {
    "cartpole": {"gpc", "gpc-2", "gpc-3", "lqr"},
    "pendulum": {"gpc", "energy"},
    "lunarlander": {"heuristic"},
    "mountaincar": {"pump"},
}
POSITIVE = (
    "policy_length_scale policy_variance human_length_scale human_variance static_rate noise beta magnitude "
    "delay_shape attention distraction credit_shape"
)
POSITIVE = frozenset(POSITIVE.split())
FROM_ZERO = "constant_rate active_gain coach_constant delay delay_longest fading credit credit_longest"
FROM_ZERO = frozenset(FROM_ZERO.split())
LISTS = ("algo", "error", "oracle", "delta", "rate", *POSITIVE, *FROM_ZERO, "policy_nu")
SERIES = "rate_schedule"
NUMBERS = {"error", "delta", "rate", "rate_schedule", "policy_nu", *POSITIVE, *FROM_ZERO}
WHOLE = {"seeds", "episodes", "max_capacity", "jobs"}
WORDS = {"env", "algo", "oracle", "on_full", "out", "rate_from"}
NAMES = sorted(NUMBERS | WHOLE | WORDS | {"sparsify"})

GOOD = {
    "env": ENVS,
    "algo": ("gpc", "gpc-ns", "coach", "gpc,coach"),
    "oracle": ("gpc", "lqr", "energy", "heuristic", "pump"),
    "on_full": ("error", "replace-nearest", "drop"),
    "out": ("here", "a b", "~/x", "-", "é"),
    "rate_from": ("there",),
    "policy_nu": ("0.5", "1.5,2.5"),
} | {name: ("1", "3", "+7", "007") for name in WHOLE}
NASTY = (
    *("", " ", "-", "--", "---", "--error", "-h", "=", ",", "0,,1", "nan", "-nan", "inf", "-inf", "Infinity", "1e400"),
    *("1e-400", "-1e-400", "1e-310", "0.0e-999", "-0.0", "1_0", "1_000.5", "0x10", "0b1", "1e3", "1.", ".5", "5e", "+-1"),  # noqa: E501
    *("\u0661", "\u0661.\u0665", "\uff11", "\u00b2", "1\u00a00", "True", "None", "1/2", "1j", "[1]", "1;2", "1 2", "'1'"),  # noqa: E501
    *("9" * 400, "9" * 5000, "1" + "0" * 20, "0." + "0" * 500 + "1", "x" * 300, "\x00", "\x1b[31m", "a\nb", "\udcff"),
    *("cartpol", "CARTPOLE", "gpc,gpc", "%s", "%(x)s", "{}", "$HOME", "-1", "-0.1", "2.5", "1000001", "16385", "1e-5"),
    *("../..", "/proc/self/nothing", "/dev/null", "a/" * 200, "\u202e", "٣,٤"),
)  # fmt: skip
TOML_NASTY = (
    *("1.0", "3.0", "nan", "inf", "-inf", "1e400", "1e-400", "-0.0", "1_0", "0x10", "0o7", "0b11", "true", "false", "''"),  # noqa: E501
    *('"1"', "[]", "[[1]]", "[1, [2]]", "{}", "{a = 1}", "1979-05-27", "07:32:00", "[true]", '["gpc", 1]', "[1.5, 2]"),
    *("0x" + "f" * 5000, "9" * 5000, "0." + "0" * 400 + "1", '"\\u0000"', '"""a\nb"""', "'''\n'''", '"\\uD800"', "1__0"),  # noqa: E501
    *("[" * 2000, "[" * 2000 + "]" * 2000, "{a = " * 2000, "[" * 17 + "]" * 17, "01", "+1", "1e5", "5.", ".5", "abc"),
    *('"cartpole', "[0, 0.1]", "[0.1, 0.1]", "[1e-400]", '"\\x"', "", "= 1", "#", "1 # 1.5", '"""', "[0.1,", "1e-310"),
)  # fmt: skip


class Drawn:
    """What one seed draws."""

    def __init__(self, seed):
        self.random = random.Random(seed)

    def name(self):
        near = ("erorr", "Error", "", "quick", "sweep", "--", "x" * 200, "error-", "help", "dry_run")
        return self.random.choice(near) if self.random.random() < 0.04 else self.random.choice(NAMES)

    def value(self, name):
        draw = self.random
        if draw.random() < 0.35:
            return draw.choice(NASTY)
        if name in GOOD:
            return draw.choice(GOOD[name])
        return ",".join(
            draw.choice(("0.5", "0.05", "1", "0.25", "1e-3")) for _ in range(draw.choice((1, 1, 2)))
        )

    def words(self):
        draw, words = self.random, []
        if draw.random() < 0.85:
            words += [draw.choice(("--env", "--env=")), draw.choice(ENVS)]
            if words[-2].endswith("="):
                words[-2:] = ["".join(words[-2:])]
        for _ in range(draw.randrange(5)):
            name, style = self.name(), draw.random()
            flag = "--" + name.replace("_", "-")
            if name == "sparsify" or style < 0.05:
                words.append(draw.choice((flag, "--no-sparsify", "--quick", "--" + flag)))
            elif style < 0.5:
                words += [flag, self.value(name)]
            else:
                words.append(f"{flag}={self.value(name)}")
        if draw.random() < 0.05:
            words.insert(draw.randrange(len(words) + 1), draw.choice(NASTY))
        return words

    def toml(self):
        draw, lines = self.random, []
        if draw.random() < 0.85:
            lines.append(f'env = "{draw.choice(ENVS)}"')
        for _ in range(draw.randrange(5)):
            name = self.name()
            key = draw.choice(
                (name, name, name, name.replace("_", "-"), f'"{name}"', f"{name}.{name}", f"[{name}]")
            )
            lines.append(f"{key} = {self.toml_value(name)}")
        if draw.random() < 0.3:
            lines.insert(
                draw.randrange(len(lines) + 1), draw.choice(("[quick]", "[[quick]]", "[quick.a]", "[x]", "["))
            )
        if draw.random() < 0.05:
            lines.append("a" + ".a" * draw.choice((3, 15, 16, 40, 2000)) + " = 1")
        return "\n".join(lines) + "\n"

    def toml_value(self, name):
        if self.random.random() < 0.35:
            return self.random.choice(TOML_NASTY)
        if name == "sparsify":
            return self.random.choice(("true", "false"))
        value = self.value(name)
        if name in WORDS or not re.fullmatch(r"[-+.,0-9e]+", value):
            return "'" + value.replace("'", "") + "'"
        return f"[{value}]" if "," in value else value


def assert_valid(spec):
    """By bounds written here, and by the kinds of Python."""
    assert isinstance(spec, SweepSpec) and spec.env in ENVS
    assert spec.algo and set(spec.algo) <= {"gpc", "gpc-ns", "coach"}
    assert spec.oracle and set(spec.oracle) <= EXPERTS[spec.env]
    assert spec.on_full in ("error", "replace-nearest", "drop") and type(spec.sparsify) is bool
    seeds = list(spec.seeds)
    assert all(type(seed) is int and 0 <= seed < 10**9 for seed in seeds) and len({*seeds}) == len(seeds)
    for count, most in ((len(seeds), 10**6), (spec.episodes, 10**6), (spec.max_capacity, 16384)):
        assert type(count) is int and 1 <= count <= most
    for chances in (spec.error, spec.rate, spec.rate_schedule):
        assert all(type(chance) is float and 0 <= chance <= 1 for chance in chances)
    assert spec.error and spec.rate and spec.delta
    assert all(type(delta) is float and 0 <= delta < math.inf for delta in spec.delta)
    for name, values in spec.hyperparameters.items():
        assert values and all(type(value) is float and math.isfinite(value) for value in values)
        if name == "policy_nu":
            assert set(values) <= {0.5, 1.5, 2.5}
        elif name in POSITIVE:
            assert min(values) >= 2.2e-308
        else:
            assert name in FROM_ZERO and min(values) >= 0
    for values in (spec.algo, spec.error, spec.oracle, spec.delta, spec.rate, *spec.hyperparameters.values()):
        assert len(set(values)) == len(values)


@pytest.fixture
def outcome(monkeypatch, tmp_path):
    """What `gpcjax WORDS --dry-run` comes to: a specification, or the one line that refuses it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    made = []
    make_spec = cli.running.make_spec
    monkeypatch.setattr(cli.running, "make_spec", lambda given: made.append(make_spec(given)) or made[-1])

    def run(*words):
        made.clear()
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = cli.main(["sweep", *words, "--dry-run"])
        said = out.getvalue() if status == 0 else err.getvalue()
        assert (
            said.endswith("\n")
            and said.count("\n") == 1
            and len(said) < 1500 + 2 * max(map(len, words), default=0)
        )
        if status == 0:
            assert not err.getvalue()
            assert_valid(made[-1])
            return made[-1]
        assert status == 2 and said.startswith("gpcjax: error: ") and not out.getvalue()
        return said

    return run


def as_written(text):
    """The numbers of a comma list that is nothing but ASCII decimals; None if it is anything else."""
    words = [word.strip(" ") for word in text.split(",")]
    decimal = r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"
    return (
        [float(word) for word in words]
        if all(re.fullmatch(decimal, word, re.ASCII) for word in words)
        else None
    )


@pytest.mark.parametrize("count", COUNTS)
def test_flags(outcome, count):
    taken = refused = 0
    for seed in range(count):
        words = Drawn(seed).words()
        if "-h" in words or "--help" in words:
            continue
        got = outcome(*words)
        if isinstance(got, str):
            refused += 1
            continue
        taken += 1
        # What was written is what it is: each list of numbers, read here a second time.
        texts = dict(re.findall(r"--([a-z-]+)=([^\x1f]*)", "\x1f".join(words)))
        for flag, text in texts.items():
            name = flag.replace("-", "_")
            if name in NUMBERS:
                numbers = as_written(text)
                assert numbers is not None, (words, text)
                value = got.hyperparameters.get(name, getattr(got, name, None))
                assert value == (tuple(numbers) if name == SERIES else tuple(dict.fromkeys(numbers)))
            elif name in WHOLE - {"jobs"}:
                counted = len(got.seeds) if name == "seeds" else getattr(got, name)
                assert re.fullmatch(r"\+?[0-9]+", text) and counted == int(text)
    assert taken > count / 20 and refused > count / 4


@pytest.mark.parametrize("count", COUNTS)
def test_files(outcome, count):
    taken = refused = 0
    for seed in range(count):
        draw = Drawn(10_000 + seed)
        Path("a.toml").write_text(draw.toml(), errors="surrogatepass")
        got = outcome("a.toml", *draw.random.choice(([], [], ["--quick"])))
        taken, refused = (taken, refused + 1) if isinstance(got, str) else (taken + 1, refused)
    assert taken > count / 20 and refused > count / 4


@pytest.mark.parametrize(
    "text",
    [
        "error" + ".a" * 50_000 + " = 1",
        "x = {a" + ".a" * 50_000 + " = 1}",
        'x = {a = """b"""", c' + ".c" * 50_000 + " = 1}",
        "[a" + ".a" * 50_000 + "]",
        "x = " + "[" * 100_000,
        "x = " + "{a = " * 50_000,
        '"' * 200_000,
        '"""' * 80_000,
        "'''" * 80_000,
        '"""' + "\\" * 200_000,
        "x = '" + "a" * 200_000,
        "a = 1\n" * 30_000,
        "[[a]]\n" * 30_000,
        "#" * 2 * LARGEST_FILE,
        "x = [" + "0.5," * 50_000 + "]",
    ],
    ids=lambda text: text[:20],
)
def test_no_file_takes_long(outcome, text):
    """Each of them in the time of its length; one that takes the square of it would be given up by the reader."""
    Path("a.toml").write_text(text)
    assert isinstance(outcome("a.toml"), str)


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("sparsify", "out", "rate_from")])
def test_two_dashes_are_no_value(outcome, name):
    flag = "--" + name.replace("_", "-")
    env = [] if name == "env" else ["--env=cartpole"]
    assert outcome(*env, f"{flag}=--").startswith(f"gpcjax: error: {flag} '--': give ")
    assert outcome(*env, flag, "--").startswith(f"gpcjax: error: {flag} has no value: give ")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--noise=1e-400", "--noise 1e-400: too small for a number in float64, give a number above 0"),
        ("--constant-rate=-1e-400", "--constant-rate -1e-400: too small for a number in float64"),
        ("--delta=1e-310", "--delta 1e-310: too small for a number in float64"),
        ("--delta=1e400", "--delta 1e400: give a number of at least 0"),
        ("--error=Infinity", "--error Infinity: give a number from 0 to 1"),
        ("--seeds=1_0", "--seeds '1_0': give a whole number"),
        ("--error=0.1_0", "--error '0.1_0': give a number"),
        ("--seeds=\u0663", "--seeds '\u0663': give a whole number"),
        ("--error=\u0660.\u0661", "--error '\u0660.\u0661': give a number"),
        ("--seeds=0x10", "--seeds '0x10': give a whole number"),
        ("--seeds=3 --seeds=3", "--seeds is given twice: give it once"),
        ("--sparsify --no-sparsify", "--no-sparsify is given twice: give it once"),
        ("--dry-run", "--dry-run is given twice: give it once"),
        ("--no-sparsify=1", "--no-sparsify '1': a switch takes no value, give --no-sparsify alone"),
    ],
)
def test_refused_as_it_was_written(outcome, words, message):
    assert outcome("--env=cartpole", *words.split()).startswith(f"gpcjax: error: {message}")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("seeds = 1.0", "seeds 1.0: give a whole number from 1"),
        ("noise = 1e-400", "noise 1e-400: too small for a number in float64"),
        ("error = [0, 1e-400]", "error 1e-400: too small for a number in float64"),
        ("noise = 1e400", "noise 1e400: give a number above 0"),
        ("seeds = 0x" + "f" * 5000, "seeds of type int: give a whole number from 1"),
        ("seeds = " + "9" * 5000, "this is not TOML: Exceeds the limit"),
        ("error" + ".a" * 2000 + " = 1", "too deep for settings"),
        ("error = " + "[" * 2000, "too deep for settings: give them as NAME = VALUE, one a line"),
        ("error = " + "[" * 16 + "]" * 16, "error [[[[[[[[[[[[[[[]]]]]]]]]]]]]]]: give a number from 0 to 1"),
    ],
    ids=lambda text: text[:20],
)
def test_a_file_is_refused_as_it_was_written(outcome, line, message):
    Path("a.toml").write_text(f'env = "cartpole"\n{line}\n')
    assert outcome("a.toml").startswith(f"gpcjax: error: a.toml: {message}")


def test_an_endless_file_is_not_read_to_its_end(outcome):
    assert "too large for settings" in outcome("/dev/zero")
