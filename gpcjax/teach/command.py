"""The words of `gpcjax teach`, checked: what is taught, where, and what it begins with. Loads no jax."""

import argparse
import os
from pathlib import Path

from gpcjax.allowed import Numbers
from gpcjax.envs.registry import check_expert
from gpcjax.errors import UserError
from gpcjax.sweep.given import Given, Unchecked
from gpcjax.sweep.layout import MANIFEST
from gpcjax.sweep.options import conditions, own_values

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
    from gpcjax.policies.folder import CARD
    from gpcjax.teach.course import COURSE, Course
    from gpcjax.teach.origin import Origin, of_run
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
        path = Path(os.path.expanduser(named))
        if (path / MANIFEST).is_file() and not (path / COURSE).is_file():
            algo = given["algo"].value[0] if "algo" in given else None
            origin = of_run(path, algo, own.get("seed"), where)
            own["seed"] = origin.seed
            usual = {"env": Given(origin.env, "--from"), "algo": Given((origin.algo,), "--from")}
            given = {**usual, **given}
        elif (path / CARD).is_file():
            origin = path
        else:
            raise UserError(
                f"--from {path}: nothing was saved there, give OUT/saves/NAME of a folder of gpcjax teach, or a run "
                "folder with kept states"
            )
    if where and (origin is None or isinstance(origin, Path)):
        raise UserError("--where: it says which run of a run folder is meant, give that (--from)")
    goes_on = not given and folder is not None and "seed" not in own
    course = None if goes_on else Course.of(given, own.get("seed", 0))
    options = Options(own.get("repeat", 8.0), own.get("speed", 1.0), oracle.value[0] if oracle else None)
    if oracle is not None and course is not None:
        check_expert(course.env, options.oracle, "--oracle")
    return teach(folder, course, origin, options, arguments.host or "127.0.0.1", own.get("port"))
