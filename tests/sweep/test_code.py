"""What code is, by its source and by what it imports: the same in every process, wherever libraries lie."""

import ast
import importlib
import importlib.util
import sys
import warnings

import pytest

from gpcjax.sweep.code import digests_of_modules
from gpcjax.sweep.digests import digests_of
from gpcjax.sweep.spec import spec_of


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder that Python imports from; what came of it is forgotten afterwards."""
    monkeypatch.syspath_prepend(str(tmp_path))
    before = set(sys.modules)
    yield tmp_path
    for name in sys.modules.keys() - before:
        if name.startswith("rule"):
            del sys.modules[name]


def write(folder, **files):
    for name, text in files.items():
        path = folder / f"{name.replace('__in__', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


@pytest.mark.parametrize(
    ("before", "after", "same"),
    [
        ("x = 1\n", "# why\nx  =  1\n", True),
        ('def f():\n    "Doc."\n    return 1\n', "def f():\n    return 1\n", True),
        (
            'def f():\n    "Doc."\n    return f.__doc__\n',
            'def f():\n    "Other."\n    return f.__doc__\n',
            False,
        ),
        ("x = 1\n", "x = 1.0\n", False),
        ("x = 0.0\n", "x = -0.0\n", False),
        ("def f(a): return a\n", "def f(a=1): return a\n", False),
        ("x = [1, 2]\n", "x = (1, 2)\n", False),
        ("not python", "not Python", False),
    ],
)
def test_what_of_a_source_counts(tmp_path, monkeypatch, before, after, same):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "rulesource.py").write_text(before)
    first = digests_of_modules(["rulesource"])
    (tmp_path / "rulesource.py").write_text(after)
    assert (digests_of_modules(["rulesource"]) == first) == same and first.keys() == {"rulesource"}


@pytest.mark.parametrize(
    "line",
    [
        "import rulepack.deep.inner",
        "from rulepack.deep import inner",
        "from rulepack.deep.inner import VALUE",
        "def late():\n    from rulepack import chained",
        'import importlib\nx = importlib.import_module("rulepack.deep.inner")',
        'SPEC = dict(make="rulepack.deep.inner:make")',
        "try:\n    import nothing_here\nexcept ImportError:\n    import rulepack.chained",
    ],
)
def test_imports_are_followed_wherever_they_stand(tmp_path, monkeypatch, line):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "rulepack" / "deep").mkdir(parents=True)
    for package in ("rulepack", "rulepack/deep"):
        (tmp_path / package / "__init__.py").write_text("")
    (tmp_path / "rulepack" / "chained.py").write_text("from .deep import inner\nimport numpy, jax, gpcjax\n")
    (tmp_path / "rulepack" / "deep" / "inner.py").write_text("from ...nowhere import x\nfrom . import *\n")
    (tmp_path / "rulesource.py").write_text(f"import os\n{line}\n")
    found = digests_of_modules(["rulesource"])
    assert {"rulesource", "rulepack", "rulepack.deep", "rulepack.deep.inner"} <= found.keys()
    assert found.keys() <= {
        "rulesource",
        "rulepack",
        "rulepack.chained",
        "rulepack.deep",
        "rulepack.deep.inner",
    }
    assert not {"rulepack", "rulesource"} & sys.modules.keys()


@pytest.mark.parametrize("line", ["from rulehelp.deep.x import y", "import rulehelp.deep.x as x"])
def test_folders_without_init_are_followed_before_anybody_imports_them(here, line):
    write(here, rulesource=f"def lazy():\n    {line}\n", rulehelp__in__deep__in__x="y = 1\n")
    found = digests_of_modules(["rulesource"])
    assert found.keys() == {"rulesource", "rulehelp.deep.x"}
    importlib.import_module("rulehelp.deep.x")
    assert digests_of_modules(["rulesource"]) == found


def test_a_finder_of_an_installation_is_asked_whether_its_module_is_loaded_or_not(here, monkeypatch):
    write(here, rulesource="import rulelib.sub\n")
    write(here / "project" / "src", rulelib="", other="")
    write(here / "project" / "src" / "lib", __init__="", sub="x = 1\n")

    class Editable:
        @staticmethod
        def find_spec(name, path=None, target=None):
            if name == "rulelib":
                init = here / "project" / "src" / "lib" / "__init__.py"
                return importlib.util.spec_from_file_location(name, init)
            if name == "rulebroken":
                raise KeyError(name)
            return None

    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path, Editable])
    found = digests_of_modules(["rulesource", "rulebroken"])
    assert found.keys() == {"rulesource", "rulelib", "rulelib.sub"}
    importlib.import_module("rulesource")
    assert digests_of_modules(["rulesource"]) == found


@pytest.mark.parametrize(
    ("told", "installed"),
    [
        ({"rulelib-1.0.dist-info/RECORD": "rulelib/__init__.py,sha256=x,1\n"}, True),
        ({"Rule_Lib-1.0.dist-info/RECORD": "../bin/x,,\nrulelib/__init__.py,,\n"}, True),
        ({"Rule_Lib-1.0.dist-info/top_level.txt": "rulelib\n"}, True),
        ({"rulelib-1.0-py3.11.egg-info/PKG-INFO": ""}, True),
        ({"rulelib.egg-info/top_level.txt": "rulelib\n"}, False),  # pip install -e
        ({"rulelib-1.0.dist-info": ""}, True),
        ({"other-1.0.dist-info/RECORD": "other.py,,\n"}, False),
        ({}, False),
    ],
)
def test_what_distributions_say_to_be_theirs_is_installed_wherever_it_lies(
    tmp_path, monkeypatch, told, installed
):
    folder = tmp_path / "target"
    write(folder, rulesource="import rulelib.deep, rulehelp\n", rulehelp="x = 1\n")
    write(folder / "rulelib", __init__="", deep="")
    for name, text in told.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.syspath_prepend(str(folder))
    library = set() if installed else {"rulelib", "rulelib.deep"}
    assert digests_of_modules(["rulesource"]).keys() == {"rulesource", "rulehelp"} | library
    assert "rulelib.deep" in digests_of_modules(["rulelib.deep"])  # it was asked for
    assert ("rulelib.deep" in digests_of_modules(["rulelib.deep"], ["rulelib"])) != installed


@pytest.mark.parametrize("name", ["site-packages", "dist-packages"])
def test_folders_of_installations_are_known_by_their_names(here, tmp_path, monkeypatch, name):
    write(here, rulesource="import rulelib\n")
    write(tmp_path / name, rulelib="")
    monkeypatch.syspath_prepend(str(tmp_path / name))
    assert digests_of_modules(["rulesource"]).keys() == {"rulesource"}


def test_warnings_of_a_source_are_neither_told_nor_heeded(here):
    write(here, rulesource='PATTERN = "\\d"  # one\n')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = digests_of_modules(["rulesource"])
    write(here, rulesource='PATTERN = "\\d"  # two\n')
    assert digests_of_modules(["rulesource"]) == found


def test_how_deep_the_caller_is_changes_nothing(here):
    write(here, rulesource=f"x = {' + '.join(map(str, range(450)))}\n")
    found = digests_of_modules(["rulesource"])
    write(here, rulesource=f"x = {' + '.join(map(str, range(450)))}  # why\n")

    def deeper(levels):
        return deeper(levels - 1) if levels else digests_of_modules(["rulesource"])

    assert deeper(450) == found


def test_each_source_is_parsed_once(here, monkeypatch):
    write(here, rulesource="import ruleother\n", ruleother="parsed = 1\n")
    parsed, parse = [], ast.parse
    monkeypatch.setattr(ast, "parse", lambda *given, **more: parsed.append(1) or parse(*given, **more))
    found = digests_of_modules(["rulesource"])
    assert digests_of_modules(["ruleother", "rulesource"]) == found and len(parsed) == 2
    write(here, ruleother="parsed = 2\n")  # as long as before, and perhaps of the same moment
    assert digests_of_modules(["rulesource"]) != found and len(parsed) == 3


def test_a_library_is_told_by_its_version(here):
    pytest.importorskip("gymnasium")
    write(here, rulesource="def act(obs): return obs[:1]\n")
    found = digests_of(spec_of(env="gym:Pendulum-v1", algo="gpc", oracle="rulesource:act", seeds=1))
    assert found["env gym:Pendulum-v1"].keys() == {"gymnasium"}
