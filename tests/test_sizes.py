"""Modules and functions stay short enough to be read at once: one job each."""

import ast
from pathlib import Path

import pytest

import gpcjax

PACKAGE = Path(gpcjax.__file__).parent
LINES, OF_A_FUNCTION = 300, 60

TEXTS = {path.relative_to(PACKAGE).as_posix(): path.read_text() for path in PACKAGE.rglob("*.py")}


@pytest.fixture(scope="module")
def trees():
    return {name: ast.parse(text) for name, text in TEXTS.items()}


def test_a_long_module_says_why(trees):
    """In its docstring, after the words `Over 300 lines:`."""
    long = {name for name, text in TEXTS.items() if text.count("\n") > LINES}
    says = {
        name for name, tree in trees.items() if f"Over {LINES} lines: " in (ast.get_docstring(tree) or "")
    }
    assert trees and long <= says, long - says


def lines_of(function):
    """Without its docstring: one that many may call has a line for each argument."""
    documented = ast.get_docstring(function) is not None
    text = function.body[0] if documented else None
    return function.end_lineno + 1 - function.lineno - (text.end_lineno + 1 - text.lineno if text else 0)


def test_functions_are_short(trees):
    long = {
        f"{name}: {node.name}"
        for name, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and lines_of(node) > OF_A_FUNCTION
    }
    assert trees and not long
