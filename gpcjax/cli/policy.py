"""The commands behind `gpcjax policy`. Standard library only."""

from gpcjax.cli.flags import JSON, WHERE, Command, Flag
from gpcjax.deploy.command import EPISODES, FIRST_SEED, SEED, USUAL_EPISODES
from gpcjax.deploy.export import NAMES, TO, TO_END
from gpcjax.sweep.options import OPTIONS

_ENVS = str(OPTIONS["env"].allowed)
_TEXT = "run folder with kept policies or states, folder of a saved policy or learner, or ENV:EXPERT"
_RUN = Flag(
    "--seed", "of the run in a run folder (default: of the run that returned most)", "SEED", str(SEED)
)
_ENV = Flag("--env", "the task, in place of the one that the folder names", "ENV", _ENVS)


def _command(text: str, *flags: Flag) -> Command:
    return Command(text, (("", flags),), word="POLICY", word_text=_TEXT, needed=True)


POLICY = {
    "info": _command("say what a policy is, and where it comes from", _RUN, WHERE, _ENV, JSON),
    "eval": _command(
        "simulate episodes of a policy, and give its mean return with an interval",
        Flag("--episodes", f"how many (default {USUAL_EPISODES})", "N", str(EPISODES)),
        Flag(
            "--seed",
            "of the first start, where a run with this seed begins; each further episode has the next one "
            "(default 0; which run of a run folder: --where seed=3)",
            "SEED",
            str(FIRST_SEED),
        ),
        WHERE,
        _ENV,
        JSON,
    ),
    "export": _command(
        "write a policy into one file in which it acts without gpcjax",
        Flag(
            "--to",
            "python (needs numpy alone), c (a header of C99 and C++) or onnx (a graph in float64); default: what --out "
            "ends in",
            "FORMAT",
            str(TO),
        ),
        Flag(
            "--out", f"the file, which ends in {TO_END} (default runs/NAME with that end)", "FILE", "a path"
        ),
        Flag(
            "--name",
            "of the function NAME_act in C, and of the graph in ONNX (default after FILE)",
            "NAME",
            NAMES,
        ),
        _RUN,
        WHERE,
        _ENV,
        JSON,
    ),
    "gif": _command(
        "write episodes of a policy as an animated GIF",
        Flag("--out", "the GIF (default runs/NAME.gif)", "FILE", "a path that ends in .gif"),
        Flag(
            "--seed",
            "of the run, and of the starts (default: of the run that returned most; 0)",
            "SEED",
            str(SEED),
        ),
        WHERE,
        _ENV,
        Flag("--episodes", "how many (default 1)", "N", "a number"),
        Flag("--speed", "times real time (default 1)", "SPEED", "a number"),
        Flag("--seconds", "of each episode that are shown (default 20)", "SECONDS", "a number"),
    ),
}
