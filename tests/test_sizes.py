"""Modules and functions stay short enough to be read at once: one job each."""

import ast
from pathlib import Path

import gpcjax

PACKAGE = Path(gpcjax.__file__).parent
LINES, OF_A_FUNCTION = 300, 60

TEXTS = {path.relative_to(PACKAGE).as_posix(): path.read_text() for path in PACKAGE.rglob("*.py")}


STILL_LONG = {
    *("sweep/executors/base.py", "sweep/progress.py", "teach/lesson.py", "teach/taught.py"),
    *("sweep/estimate.py: seconds_left", "teach/run.py: teach"),
}
"""No other one may be."""


def test_a_long_module_says_why():
    """In its docstring, after the words `Over 300 lines:`."""
    long = {name for name, text in TEXTS.items() if text.count("\n") > LINES}
    says = {
        name
        for name, text in TEXTS.items()
        if f"Over {LINES} lines: " in (ast.get_docstring(ast.parse(text)) or "")
    }
    assert TEXTS and long <= says | STILL_LONG, long - says


def test_functions_are_short():
    long = {
        f"{name}: {node.name}"
        for name, text in TEXTS.items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (node.end_lineno or 0) - node.lineno >= OF_A_FUNCTION
    }
    assert long <= STILL_LONG
