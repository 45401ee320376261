"""Modules and functions stay short enough to be read at once: one job each."""

import ast
from pathlib import Path

import pytest

import gpcjax

PACKAGE = Path(gpcjax.__file__).parent
LINES, OF_A_FUNCTION = 300, 60

TEXTS = {path.relative_to(PACKAGE).as_posix(): path.read_text() for path in PACKAGE.rglob("*.py")}


def lines_of(function):
    """Without its docstring: one that many may call has a line for each argument."""
    documented = ast.get_docstring(function) is not None
    text = function.body[0] if documented else None
    return function.end_lineno + 1 - function.lineno - (text.end_lineno + 1 - text.lineno if text else 0)


@pytest.fixture(scope="module")
def modules():
    """The docstring of each, and the lines of its functions: all trees at once would be a million objects."""
    found = {}
    for name, text in TEXTS.items():
        tree = ast.parse(text)
        functions = [
            (node.name, lines_of(node))
            for node in ast.walk(tree)
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        ]
        found[name] = ast.get_docstring(tree) or "", functions
    return found


def test_a_long_module_says_why(modules):
    """In its docstring, after the words `Over 300 lines:`."""
    long = {name for name, text in TEXTS.items() if text.count("\n") > LINES}
    says = {name for name, (docstring, _) in modules.items() if f"Over {LINES} lines: " in docstring}
    assert modules and long <= says, long - says


def test_functions_are_short(modules):
    long = {
        f"{name}: {function}"
        for name, (_, functions) in modules.items()
        for function, lines in functions
        if lines > OF_A_FUNCTION
    }
    assert modules and not long
