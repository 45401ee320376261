"""What is written of a lesson beside its recording: its rows, and the policy so far."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gpcjax.learners.base import Learner, State
from gpcjax.learners.saved import save_policy
from gpcjax.policies.saved import has_format
from gpcjax.teach.course import POLICY, Course
from gpcjax.teach.rows import write_rows


class Kept(NamedTuple):
    """Rows and policy as they are at some point."""

    folder: Path
    course: Course
    learner: Learner
    state: State
    """Its arrays are numpy's: to hand these to another process costs no copy."""
    corrections: int
    measured: tuple[dict[str, np.ndarray], ...]

    def write(self) -> None:
        """Writes them, in place of those before; of a learner of one's own whose policy has no format, rows alone.

        Raises:
            UserError, OSError: they cannot be written.
        """
        provenance = {"env": self.course.env, "corrections": self.corrections}
        state = jax.tree.map(jnp.asarray, self.state)
        if has_format(self.learner.policy_of(state).controller):
            replaced(self.folder / POLICY, lambda path: save_policy(path, self.learner, state, **provenance))
        write_rows(self.folder, self.course, *self.measured)


def plain(leaf: Any) -> Any:
    """An array of a state as numpy's, but for random keys, which numpy does not know."""
    return leaf if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else np.asarray(leaf)


def replaced(path: Path, write: Callable[[Path], Any]) -> None:
    """Makes a folder anew by `write`: there is an old one or a new one at any time, but for a moment."""
    path.parent.mkdir(parents=True, exist_ok=True)
    new, old = path.with_name(f".{path.name}.new"), path.with_name(f".{path.name}.old")
    for left in (new, old):
        shutil.rmtree(left, ignore_errors=True)
    write(new)
    if path.exists():
        path.rename(old)
    new.rename(path)
    shutil.rmtree(old, ignore_errors=True)
