"""Folders and files that a specification names as they lie on another machine. Standard library only.

A worker on another machine gets what a sweep names (experts, recordings, what runs begin with) in a folder of its own.
Cells keep the names, which are part of their rows: only who opens such a path asks here where it lies.
"""

import functools
import json
import os

VARIABLE = "GPCJAX_ELSEWHERE"
"""Of the environment of a worker on another machine: where paths lie, as JSON."""


def path_here(named: str) -> str:
    """Where a named path lies on this machine: what was sent along, or the path itself with its `~` resolved."""
    return _moved().get(named) or os.path.expanduser(named)


@functools.cache
def _moved() -> dict[str, str]:
    return json.loads(os.environ.get(VARIABLE, "{}"))
