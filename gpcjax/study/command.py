"""The words of `gpcjax study`, checked, and what it does with them. Loads no jax before a study runs."""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

from gpcjax.allowed import Anything, Numbers, shown
from gpcjax.errors import UserError
from gpcjax.sweep.lock import held, holder
from gpcjax.sweep.options import own_values
from gpcjax.teach.command import PORT

PLACES = Numbers(1, 512, whole=True)
USUAL_PLACES = 64

STATUS, DELETE, REPORT, BOTS = "status", "delete", "report", "bots"

NUMBER = Numbers(1, 512, whole=True)
SEED = Numbers(0, 900_000_000, whole=True)
USUAL_NUMBER = 64


_WANTED = {STATUS: "OUT", REPORT: "OUT", DELETE: "OUT CODE", BOTS: "ADDRESS"}
"""What is given behind a word."""


def study(arguments: argparse.Namespace) -> int:
    """Holds a study, says how far it is, reports on it, deletes a participant or rehearses it, as the words say.

    Raises:
        UserError: a mistake of the person's.
    """
    words = arguments.study or []
    own = own_values(
        arguments,
        ("port", int, PORT),
        ("places", int, PLACES),
        ("address", str, Anything("an address")),
        ("number", int, NUMBER),
        ("seed", int, SEED),
    )
    word = words[0] if words else ""
    taken = ("number", "seed") if word == BOTS else ("out", "host", "port", "places", "address")
    if word in (STATUS, DELETE, REPORT):
        taken = ()
    for name in ("out", "host", "port", "places", "address", "number", "seed"):
        if name not in taken and getattr(arguments, name) is not None:
            beside = f"beside {word}" if word in _WANTED else f"without {BOTS}"
            raise UserError(f"--{name}: {beside} it changes nothing, leave it out")
    match words:
        case ["status", out]:
            from gpcjax.study.status import status

            print(status(_path(out)))
            return 0
        case ["delete", out, code]:
            return _delete(_path(out), code)
        case ["report", out]:
            return _report(_path(out))
        case ["bots", address]:
            return _rehearse(address, own.get("number", USUAL_NUMBER), own.get("seed", 0))
        case ["status" | "delete" | "report" | "bots" as word, *_]:
            raise UserError(f"gpcjax study {word}: give {_WANTED[word]} behind it")
        case [] if arguments.out is None:
            raise UserError("no study: give its TOML file, or the folder of one that goes on (--out OUT)")
        case [] | [_]:
            spec = _path(words[0]) if words else None
            out = _path(arguments.out) if arguments.out is not None else None
            return _hold(spec, out, arguments.host or "127.0.0.1", own)
    raise UserError(
        f"{shown(words[1])} is one value too many: give one TOML file, or "
        + ", or ".join(f"{name} {wanted}" for name, wanted in _WANTED.items())
    )


def _path(word: str) -> Path:
    return Path(os.path.expanduser(word))


def _hold(spec: Path | None, out: Path | None, host: str, own: dict) -> int:
    from gpcjax.study.register import Register, new_folder, open_folder

    if out is None:
        assert spec is not None
        from gpcjax.study.reading import read_study

        read_study(spec)  # its mistakes come before a folder's name
        out = new_folder(spec)
    what = open_folder(out, spec)
    if (who := holder(out)) is not None:
        raise UserError(f"{out}: the study runs already ({who}), end it before")
    with held(out):
        register = Register(out, what)
        register.kept_number()  # what is damaged there is told now, and not to the first who comes
        register.expire()
        try:
            from gpcjax.study.server import Serving, host_of
        except ImportError as error:
            from gpcjax.teach.run import EXTRA

            raise UserError(EXTRA.format(error).replace("gpcjax teach", "gpcjax study")) from None
        if own.get("address") is not None:
            host_of(own["address"], "--address")
        from gpcjax.study.hall import Hall
        from gpcjax.sweep.environment import compute_here
        from gpcjax.teach.run import ENDED, SWITCH_SECONDS

        places = own.get("places", USUAL_PLACES)
        compute_here()
        sys.setswitchinterval(SWITCH_SECONDS)
        told: list[Callable[[str], None]] = [_say]
        hall = Hall(what.every_course(), places, lambda text: told[-1](text))
        serving = Serving(register, hall, places, host, own.get("port"), own.get("address"))
        told.append(serving.reception.fault)
        print(f"compiling for {places} places: a minute or more", flush=True)
        hall.start()
        stopped: KeyboardInterrupt | None = None
        try:
            print(f"participants: {serving.address}", flush=True)
            print(f"experimenter: {serving.experimenter}", flush=True)
            print(f"Ctrl-C ends it; {out} keeps everything, gpcjax study --out {out} goes on", flush=True)
            serving.run()
        except KeyboardInterrupt as stop:
            stopped = stop
        finally:
            hall.close()
        if all(each.step is None for each in register) and not register.free:
            _report(out)
    print(f"kept in {out}: gpcjax study --out {out} goes on with it")
    if stopped is not None and getattr(stopped, "status", ENDED) != ENDED:
        raise stopped
    return 0


def _delete(out: Path, code: str) -> int:
    from gpcjax.study.register import Register, read_folder

    what = read_folder(out)
    if (who := holder(out)) is not None:
        raise UserError(
            f"{out}: the study runs ({who}): delete {code} on the experimenter's page, or end it before"
        )
    with held(out):
        removed = Register(out, what).delete(code)
    for each in removed:
        print(f"removed {each}")
    print(f"nothing of {code} is left in {out}; copies elsewhere, and downloads, are yours to delete")
    return 0


def _report(out: Path) -> int:
    from gpcjax.study.report.run import draw

    for path in draw(out, _say):
        print(f"wrote {path}")
    return 0


def _rehearse(address: str, number: int, seed: int) -> int:
    try:
        from gpcjax.study.bots.crowd import rehearse, table
    except ImportError as error:
        from gpcjax.teach.run import EXTRA

        raise UserError(EXTRA.format(error).replace("gpcjax teach", "gpcjax study bots")) from None
    outcomes = rehearse(address, number, seed, say=lambda line: print(line, flush=True))
    print(table(outcomes))
    return 0


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
