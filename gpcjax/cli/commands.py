"""The commands: their flags, and the word that is none. Standard library only."""

from dataclasses import replace

from gpcjax.cli.flags import JSON, WHERE, Command, Flag, flag_of, help_of
from gpcjax.cli.policy import POLICY
from gpcjax.reproduce.parts import PARTS, folder
from gpcjax.study.command import NUMBER, PLACES, USUAL_NUMBER, USUAL_PLACES
from gpcjax.study.command import SEED as BOTS_SEED
from gpcjax.sweep.options import (
    EXPERIMENT,
    OF_CREDIT,
    OF_LEARNERS,
    OF_TEACHERS,
    OPTIONS,
    RUNNING,
    VARIANTS,
    Option,
)
from gpcjax.teach.command import PORT, REPEAT, SEED, SPEED
from gpcjax.tune.flags import FLAGS, NOT_TAKEN

_ENVS, _PARTS, _FOLDER = str(OPTIONS["env"].allowed), ", ".join(PARTS), str(OPTIONS["out"].allowed)

_GROUPS = (
    ("experiment", EXPERIMENT),
    ("variants of GPC and GPC-NS", VARIANTS),
    ("hyperparameters of the learners (without them, the tables of the thesis)", OF_LEARNERS),
    ("the teacher, beside Alg. 4 of the thesis", OF_TEACHERS),
    ("how a learner reckons with late advice", OF_CREDIT),
    ("running", RUNNING),
)


def _sweep(name: str) -> Command:
    switches = (
        Flag("--dry-run", "check all, say how many cells, run nothing"),
        Flag("--live", "keep report.html and its figures fresh while it runs"),
        Flag("--quick", "with the settings of the file's table [quick]"),
        JSON,
    )
    own = Flag(
        "--set",
        "a setting of a learner or teacher of one's own, by its name; may be given several times",
        "NAME=A,B,...",
        value="NAME=VALUE",
        repeated=True,
    )
    groups = tuple((title, tuple(flag_of(option, name) for option in options)) for title, options in _GROUPS)
    text = "a file with these names as keys; flags win"
    return Command(_TEXTS[name], (*groups, ("", (own, *switches))), word="TOML", word_text=text)


def _tune() -> Command:
    """A sweep's settings, and where to look for which of them."""
    sweep = _sweep("tune")
    *groups, (_, (setting, *_)) = sweep.groups
    look = Flag(
        "--search",
        "where to look for a setting, by factors where its range is above zero; may be given several times",
        "NAME=LOW:HIGH",
        value="NAME=LOW:HIGH or NAME=A,B,C",
        repeated=True,
    )
    flags = tuple(
        Flag(f"--{name.replace('_', '-')}", own.help, own.metavar, str(own.allowed))
        for name, own in FLAGS.items()
    )
    switches = tuple(
        flag
        for _, flags in sweep.groups[-1:]
        for flag in flags
        if flag.name in ("--dry-run", "--quick", "--json")
    )
    groups = [
        (title, tuple(replace(flag, hidden=flag.key in NOT_TAKEN) for flag in flags))
        for title, flags in groups
    ]
    text = "a file of a sweep's settings, with a table [tune] of these flags and [tune.search]; flags win"
    return replace(
        sweep,
        groups=(("search", (look, *flags, WHERE)), *groups, ("", (setting, *switches))),
        word_text=text,
    )


def _teach() -> Command:
    """What a person teaches has one learner, with one value of each setting."""

    def alone(option: Option) -> Flag:
        return replace(flag_of(option, "teach"), metavar=option.name.upper())

    flags = {name: alone(OPTIONS[name]) for name in ("env", "algo", "oracle", "out")}
    learner, expert = OPTIONS["algo"], OPTIONS["oracle"]
    algo = f"{learner.text} ({learner.allowed}; default gpc, or gpc-ns on a task without values for it)"
    whose = f"whose mean return is drawn as a line ({expert.allowed})"
    lesson = (
        flags["env"],
        replace(flags["algo"], text=algo),
        Flag("--seed", "of the starts, as in a sweep (default 0)", "SEED", str(SEED)),
        Flag("--repeat", "advices a second while a key is held (default 8)", "REPEAT", str(REPEAT)),
        Flag("--speed", "times real time (default 1)", "SPEED", str(SPEED)),
        replace(flags["oracle"], text=whose),
        Flag(
            "--from",
            "what to begin with: OUT/saves/NAME of another folder, or a run folder with kept states",
            "FOLDER",
            _FOLDER,
        ),
        WHERE,
        replace(
            flags["out"],
            text="folder that keeps it, or has kept it and goes on (default runs/taught-ENV-NUMBER)",
        ),
        Flag(
            "--host",
            "listens on this address; beyond 127.0.0.1 with a token (default 127.0.0.1)",
            "HOST",
            "an address",
        ),
        Flag("--port", "on this port (default the first from 8765 on that is free)", "PORT", str(PORT)),
    )
    # The room of a dictionary, and what a full one does, are those of any lesson.
    variants = tuple(
        flag_of(option, "teach") for option in VARIANTS if option.name not in ("on_full", "max_capacity")
    )
    own = Flag("--set", "a setting of a learner of one's own", "NAME=VALUE", "NAME=VALUE", repeated=True)
    return Command(
        _TEXTS["teach"],
        (
            ("lesson", lesson),
            ("variants of GPC and GPC-NS", variants),
            ("hyperparameters of the learners", tuple(map(alone, OF_LEARNERS))),
            ("how a learner reckons with late advice", tuple(map(alone, OF_CREDIT))),
            ("", (own,)),
        ),
    )


def _study() -> Command:
    flags = (
        Flag(
            "--out",
            f"folder that keeps it, or has kept it and goes on ({_FOLDER}; default runs/study-NAME-NUMBER)",
            "OUT",
            _FOLDER,
        ),
        Flag("--host", "listens on this address (default 127.0.0.1)", "HOST", "an address"),
        Flag("--port", "on this port (default the first from 8765 on that is free)", "PORT", str(PORT)),
        Flag(
            "--address",
            "https://HOST, as participants open it, where a proxy with TLS hands it on",
            "ADDRESS",
            "https://HOST",
        ),
        Flag("--places", f"people who teach at once ({PLACES}; default {USUAL_PLACES})", "N", str(PLACES)),
        Flag("--number", f"of scripted participants ({NUMBER}; default {USUAL_NUMBER})", "N", str(NUMBER)),
        Flag("--seed", f"of what scripted participants draw ({BOTS_SEED}; default 0)", "N", str(BOTS_SEED)),
    )
    text = (
        "the TOML file of a study; or status OUT, how far it is; report OUT, its rows and figures; delete OUT CODE, a "
        "participant everywhere; or bots ADDRESS, scripted participants who rehearse it"
    )
    return Command(_TEXTS["study"], (("", flags),), word="STUDY", word_text=text, several=True)


def _compare() -> Command:
    flags = (
        Flag(
            "--by",
            "settings in which runs may differ that have no partner of the same settings (default: the one in which "
            "the folders differ, if it is one and has one value in each)",
            "A,B,...",
            "names of settings",
        ),
        Flag("--out", f"folder of the comparison ({_FOLDER}; default runs/compare-NAMES)", "OUT", _FOLDER),
    )
    return Command(
        _TEXTS["compare"],
        (("", flags),),
        word="FOLDER",
        word_text="run folders of one task, two or more",
        needed=True,
        several=True,
    )


def _merge() -> Command:
    out = f"the run folder of the whole ({_FOLDER}; default the one FOLDER that holds all shards)"
    return Command(
        _TEXTS["merge"],
        (("", (Flag("--out", out, "OUT", _FOLDER), JSON)),),
        word="FOLDER",
        word_text="run folders of shards, or folders with a folder of them (OUT of the sweep)",
        needed=True,
        several=True,
    )


def _play() -> Command:
    flags = (
        Flag(
            "--seed",
            "of the run, and of the starts (default: of the run that returned most; 0)",
            "SEED",
            str(SEED),
        ),
        WHERE,
        Flag("--env", "the task, in place of the one that the folder names", "ENV", _ENVS),
        Flag("--episodes", "how many (default 1)", "N", "a number"),
        Flag("--speed", "times real time (default 1)", "SPEED", "a number"),
        Flag(
            "--seconds",
            "of each episode that are shown (default all of it; 20 in a GIF)",
            "SECONDS",
            "a number",
        ),
        Flag(
            "--gif",
            "the GIF that is written (default: where a window can be opened, none; elsewhere runs/play-NAME.gif)",
            "FILE",
            "a path that ends in .gif",
        ),
    )
    text = "run folder with kept policies or states, folder of a saved policy or learner, or ENV:EXPERT"
    return Command(_TEXTS["play"], (("", flags),), word="OUT", word_text=text, needed=True)


_TEXTS = {
    "sweep": "teach every combination of learner, error rate and seed, then report",
    "grid": "the same over lists of hyperparameters, with a heatmap",
    "tune": "search for hyperparameters, and judge the best on other seeds",
    "report": "draw a run folder's table and figures again",
    "compare": "compare run folders, run by run of the same seed",
    "merge": "put the shards of a sweep together, when all are there, then report",
    "oracles": "learn the shipped oracles again",
    "reproduce": "run the experiments of the thesis, and say what becomes of its claims",
    "teach": "teach a policy by hand, in the browser",
    "study": "hold a study: people teach blind, many at once, in the browser",
    "play": "show a policy in a window, or as an animated GIF",
    "policy": "say what a policy is and how well it does, and export it",
    "replay": "make what was taught by hand again, and see whether it comes to the same",
    "runs": "list run folders, and how far they are",
    "show": "say what a run folder holds, and check all of it",
    "version": "print the version",
}
COMMANDS = {
    "sweep": _sweep("sweep"),
    "grid": _sweep("grid"),
    "tune": _tune(),
    "report": Command(
        _TEXTS["report"], (("", (JSON,)),), word="OUT", word_text="the run folder", needed=True
    ),
    "compare": _compare(),
    "merge": _merge(),
    "oracles": Command(
        _TEXTS["oracles"],
        (("", (Flag("--env", f"{_ENVS}, comma list (default: each)", "ENV", _ENVS),)),),
    ),
    "reproduce": Command(
        _TEXTS["reproduce"],
        (
            (
                "",
                (
                    Flag("--only", f"parts ({_PARTS}; default all)", "A,B,...", _PARTS),
                    Flag("--quick", "few short runs of each experiment"),
                    Flag(
                        "--out",
                        f"folder of all runs and the report (default {folder(quick=False)})",
                        "OUT",
                        _FOLDER,
                    ),
                    Flag(
                        "--sweeps",
                        "folder of the TOML files (default: those of the package)",
                        "SWEEPS",
                        _FOLDER,
                    ),
                    Flag("--jobs", help_of(OPTIONS["jobs"], "reproduce"), "N", str(OPTIONS["jobs"].allowed)),
                    Flag("--dry-run", "check all, run nothing"),
                ),
            ),
        ),
    ),
    "teach": _teach(),
    "study": _study(),
    "play": _play(),
    "policy": Command(_TEXTS["policy"], parts=POLICY),
    "replay": Command(_TEXTS["replay"], word="OUT", word_text="a folder of gpcjax teach", needed=True),
    "runs": Command(
        _TEXTS["runs"],
        (("", (JSON,)),),
        word="FOLDER",
        word_text="the folder that holds them (default runs)",
    ),
    "show": Command(_TEXTS["show"], (("", (JSON,)),), word="OUT", word_text="the run folder", needed=True),
    "version": Command(_TEXTS["version"]),
}
