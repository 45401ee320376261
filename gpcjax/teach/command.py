"""The words of `gpcjax teach`, checked: what is taught, where, and what it begins with. Loads no jax."""

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from gpcjax.allowed import Numbers
from gpcjax.envs.registry import check_expert
from gpcjax.errors import UserError
from gpcjax.sweep.given import Given, Unchecked
from gpcjax.sweep.layout import MANIFEST, tell
from gpcjax.sweep.options import conditions, own_values

if TYPE_CHECKING:
    from gpcjax.teach.origin import Origin

SEED = Numbers(0, 2**31 - 1, whole=True)
REPEAT = Numbers(1, 50)
SPEED = Numbers(0.1, 2.0)
PORT = Numbers(0, 65535, whole=True)
"""Values of the flags that are no settings of a sweep."""


def by_hand(arguments: argparse.Namespace, given: dict[str, Given | Unchecked]) -> int:
    """Holds the lesson that these words ask for; `given` are those among them that a sweep knows too.

    Raises:
        UserError: a mistake of the person's.
    """
    from gpcjax.teach.course import COURSE, Course
    from gpcjax.teach.origin import Run
    from gpcjax.teach.run import teach
    from gpcjax.teach.standing import Options

    own = own_values(
        arguments,
        ("seed", int, SEED),
        ("repeat", float, REPEAT),
        ("speed", float, SPEED),
        ("port", int, PORT),
    )
    out, oracle = given.pop("out", None), given.pop("oracle", None)
    folder = Path(os.path.expanduser(out.value)) if out is not None else None
    origin: Origin | None = None
    named, where = getattr(arguments, "from"), conditions(arguments.where)
    if named is not None:
        given, origin = _begun_with(Path(os.path.expanduser(named)), given, own.get("seed"), where)
        if isinstance(origin, Run):
            own["seed"] = origin.seed
    if where and (origin is None or isinstance(origin, Path)):
        raise UserError("--where: it says which run of a run folder is meant, give that (--from)")
    goes_on = not given and folder is not None and "seed" not in own
    course = None if goes_on else Course.of(given, own.get("seed", 0))
    options = Options(own.get("repeat", 8.0), own.get("speed", 1.0), oracle.value[0] if oracle else None)
    taught = course
    if taught is None and folder is not None and (folder / COURSE).exists():
        taught = Course.read(folder)
    if oracle is not None and taught is not None:
        check_expert(taught.env, options.oracle, "--oracle")
    return teach(folder, course, origin, options, arguments.host or "127.0.0.1", own.get("port"))


def _begun_with(
    path: Path, given: dict[str, Given | Unchecked], seed: int | None, where: dict[str, str]
) -> tuple[dict[str, Given | Unchecked], "Origin"]:
    """What a lesson begins with, and the settings: those that were given, else those that were learned with there.

    What of these does not count is told.

    Raises:
        UserError: nothing is there, or it is not clear which, or it means nothing to the learner that was given.
    """
    from gpcjax.policies.folder import CARD
    from gpcjax.teach.course import COURSE
    from gpcjax.teach.made_with import as_given
    from gpcjax.teach.origin import of_run
    from gpcjax.teach.saved import of_saved

    algo, env = given.get("algo"), given.get("env")
    wanted, task = algo.value[0] if algo is not None else None, env.value if env is not None else None
    if (path / MANIFEST).is_file() and not (path / COURSE).is_file():
        origin = found = of_run(path, wanted, seed, where, task)
    elif (path / CARD).is_file():
        origin, found = path, of_saved(path, wanted, task)
    else:
        raise UserError(
            f"--from {path}: nothing was saved there, give OUT/saves/NAME of a folder of gpcjax teach, or a run "
            "folder with kept states"
        )
    if env is None and found.env is None:
        raise UserError(f"--from {path}: it does not say what it learned, give the task (--env)")
    if env is not None and found.env not in (None, env.value):
        tell(
            f"--from {path}: what was learned on {found.env} is taught {env.value} now, with the settings of "
            f"{found.algo} there"
        )
    elif found.settings is None and (env is not None or found.env is not None):
        tell(
            f"--from {path}: {found.algo} goes on with what another learner learned, with settings of its own"
        )
    settings = found.settings or {}
    rates = {"static_rate", "constant_rate"}  # of which there is one
    if rates & given.keys():
        settings = {name: value for name, value in settings.items() if name not in rates}
    usual: dict[str, Given | Unchecked] = {"algo": Given((found.algo,), "--from")}
    if found.env is not None:
        usual["env"] = Given(found.env, "--from")
    return {**usual, **as_given(f"--from {path}", settings), **given}, origin
