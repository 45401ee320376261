"""What a sweep is: one frozen specification made from flags, a TOML file or Python. Loads no jax."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from gpcjax.allowed import shown, suggestion
from gpcjax.describe import Setting
from gpcjax.envs.registry import NOBODY
from gpcjax.errors import UserError
from gpcjax.lateness import CREDIT, DELAY
from gpcjax.lateness import check as check_lateness
from gpcjax.registry import find, resolve
from gpcjax.sweep import points as joint
from gpcjax.sweep.fitting import check_advised, check_concerns, learners_for
from gpcjax.sweep.given import Given, Unchecked, checked_as, said
from gpcjax.sweep.options import (
    EXPERIMENT,
    OPTIONS,
    OWNED,
    TUNING,
    VARIANTS,
    Option,
    accept,
    option_of,
    settings_of,
)
from gpcjax.sweep.points import POINTS, Point
from gpcjax.sweep.scales import SCALES, check_scale
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.source import Source
from gpcjax.sweep.tomlfile import read_file

ORACLE = OPTIONS["teacher"].default
"""The teacher of the thesis (Alg. 4)."""


@dataclass(frozen=True)
class SweepSpec:
    """A sweep: every combination of the tuples, for each seed. `make_spec` and `spec_of` make a checked one."""

    env: str
    """The task, as `gpcjax.registry` finds it."""
    algo: tuple[str, ...]
    """Learners, likewise."""
    error: tuple[float, ...]
    """Chances that an advice has the wrong sign."""
    seeds: Seeds
    """Each of them makes a run of everything."""
    episodes: int
    """Episodes of each run."""
    oracle: tuple[str, ...]
    """Experts of `env` whose actions the teacher aims at: names, folders of saved policies, `module:function`.

    `NOBODY` alone where the task has none and the teacher wants none.
    """
    delta: tuple[float, ...]
    """Distances from the target within which the teacher is silent, in units of the action."""
    rate: tuple[float, ...]
    """Chances of advice at a step and action dimension."""
    rate_schedule: tuple[float, ...]
    """That chance in each episode (the last one from then on) in place of `rate`; empty if there is none."""
    sparsify: bool
    """SPARS (Alg. 3) on or off."""
    on_full: str
    """What a dictionary does that is full at `max_capacity`: one of `ON_FULL`."""
    max_capacity: int
    """Points in a dictionary at most."""
    hyperparameters: Mapping[str, tuple[float, ...]] = field(hash=False)
    """Values of the learners' and the teacher's settings instead of presets, by name; only those that were given."""
    teacher: str = ORACLE
    """Who teaches, as `gpcjax.registry` finds it."""
    start: Source | None = None
    """What was learned elsewhere, with which its runs begin; None if with nothing."""
    scaling: tuple[float, ...] = ()
    """w of the learners that scale observations, instead of the preset; empty for that one."""
    human_scaling: tuple[float, ...] = ()
    """The same of human models, for observation and action."""
    points: tuple[Point, ...] = ()
    """Settings that belong together, instead of presets: each point with each combination of the lists."""


LATENESS = {*CREDIT, *DELAY}
"""Settings that must fit together with a task's time: they take lists, but are no part of points."""

QUICK = "quick"
"""A table of settings in a TOML file that make its sweep a small one, used where that is asked for."""


def read_toml(path: Path, quick: bool = False, beside: str = "") -> dict[str, Given | Unchecked]:
    """The settings of a TOML file, each checked alone; with `quick` those of its table [quick] win.

    A table of the name `beside` is left out (`read_table`).

    Raises:
        UserError: the file is missing, is not TOML, is no file of settings by its size or depth, has a key or value
            that is not allowed, or has no table [quick] though `quick` asks for it.
    """
    table = read_file(path)
    table.pop(beside, None)
    has_small, small = QUICK in table, table.pop(QUICK, {})
    if not isinstance(small, dict):
        raise UserError(f"{path}: {QUICK} is no table: begin one with a line [{QUICK}]")
    given, fewer = accepted_of(table, f"{path}: "), accepted_of(small, f"{path}: [{QUICK}] ")
    if quick and not has_small:
        raise UserError(f"{path}: it has no table [{QUICK}]: leave --quick out, or add the table")
    if quick:
        return given | fewer
    unused = {name: each for name, each in fewer.items() if isinstance(each, Unchecked) and name not in given}
    return given | {name: each._replace(counts=False) for name, each in unused.items()}


def spec_of(**settings: Any) -> SweepSpec:
    """The specification with these settings, named as in TOML: `spec_of(env="cartpole", error=[0, 0.1], seeds=20)`.

    Raises:
        UserError: a name or value that is not allowed.
    """
    given = accepted_of(settings, "")
    if "rate_from" in given:
        raise UserError("rate_from: give rate_schedule, the chances themselves, here")
    return make_spec(given)


def make_spec(given: Mapping[str, Given | Unchecked], *, live: bool = False) -> SweepSpec:
    """The specification of settings: defaults filled in, and all that must fit together does.

    `out`, `jobs` and `rate_from` may be among the settings; they are no part of it. `live` is for what a person
    teaches: its rows are those of such a sweep, but no sweep can make them.

    Raises:
        UserError: no env, an oracle that the env has not, a setting that nobody has, or one that would change nothing.
    """
    if "env" not in given:
        raise UserError(f"no env: give {OPTIONS['env'].allowed} (--env, or env = in the TOML file)")
    settings = {name: setting.value for name, setting in given.items() if isinstance(setting, Given)}
    task = find("task", settings["env"])
    asked = given.get("algo")
    algo = learners_for(task, asked if isinstance(asked, Given) else None)
    learners = [find("learner", name) for name in algo]
    teacher = find("teacher", settings.get("teacher", ORACLE))
    if teacher.live and not live:
        raise UserError(
            f"teacher {teacher.name}: in a sweep nobody is there to advise: teach with gpcjax teach, and give its "
            "folder as teacher"
        )
    for learner in learners:
        if not isinstance(learner.make, str) and task.sizes is not None:
            resolve("gpcjax.learners.foreign:check_made")(learner, task.sizes)
    own = settings_of(learners, [teacher])
    known = {name: _known(name, setting, own) for name, setting in given.items() if name != POINTS}
    known = {name: setting for name, setting in known.items() if getattr(given[name], "counts", True)}
    check_advised(task, teacher, known.get("oracle"))
    points = _points(given.get(POINTS), own, known)
    known |= {name: Given(None, given[POINTS].source) for name in joint.names_of(points)}
    check_concerns(known, algo, learners, teacher)
    value = {name: setting.value for name, setting in known.items() if name in given}
    defaults = {option.name: option.default for option in EXPERIMENT + VARIANTS} | {
        "algo": algo,
        "episodes": task.episodes,
        "oracle": (teacher.name,) if teacher.live else tuple(task.experts)[:1] or (NOBODY,),
        "max_capacity": task.max_capacity,
        "rate_schedule": (),
        **dict.fromkeys(SCALES, ()),
    }
    fields = {name: value.get(name, default) for name, default in defaults.items()}
    ours = [option.name for option in TUNING]
    fields["hyperparameters"] = {name: value[name] for name in [*ours, *sorted(own)] if name in value}
    fields[POINTS] = points
    if "start" in known:
        from gpcjax.sweep.sources import source_of  # which reads run folders: only where one is named

        fields["start"] = source_of(value["start"], known["start"].source)
    places = {name: setting.source for name, setting in known.items()}
    for name in SCALES:
        check_scale(name, fields[name], places.get(name, name), task)
    for names in (CREDIT, *((DELAY,) if teacher.name == ORACLE else ())):
        check_lateness(names, fields["hyperparameters"], places, task.seconds)
    return SweepSpec(**fields)


def _known(name: str, setting: Given | Unchecked, own: Mapping[str, tuple[Setting, ...]]) -> Given:
    """The setting, checked by those of the sweep that have it, if it is none of the built-in ones."""
    if isinstance(setting, Given) and (name not in own or name not in OPTIONS):
        return setting
    if isinstance(setting, Given):
        setting = getattr(setting, "unchecked", None) or Unchecked(setting.value, setting.source, name)
    assert isinstance(setting, Unchecked)
    if name not in own and name in OPTIONS:
        return Given(checked_as(OPTIONS[name], setting), setting.source)
    if name not in own:
        known = list(dict.fromkeys([*OPTIONS, *own]))
        key, near = shown(setting.key), suggestion(name, known)
        prefix = setting.source.removesuffix(setting.key)
        raise UserError(f"{prefix}{key} is no setting{near}: give {', '.join(known)}")
    return Given(_strictest(own[name], lambda option: checked_as(option, setting)), setting.source)


def _strictest(owners: Sequence[Setting], read: Callable[[Option], Any]) -> Any:
    """What all who have a setting take, as whole numbers if one of them wants such."""
    values = {each.kind: read(option_of(each)) for each in owners}
    return values.get(int, values.get(float))


def _points(
    given: Given | Unchecked | None, own: Mapping[str, tuple[Setting, ...]], alone: Mapping[str, Given]
) -> tuple[Point, ...]:
    """The points that were given, each value checked by all learners and teachers that have the setting."""

    def accepted(name: str, value: Any, source: str) -> float:
        if name not in own or name in LATENESS:
            known = sorted(own.keys() - LATENESS)
            raise UserError(
                f"{source} is no setting of points{suggestion(name, known)}: give {', '.join(known)}"
            )
        if name in alone:
            raise UserError(f"{alone[name].source}: it is a setting of the points, too: give it in one place")
        checked = _strictest(own[name], lambda option: accept(option, value, source))
        if len(checked) != 1:
            raise UserError(f"{source} {shown(value)}: give one number for each point")
        return checked[0]

    return () if given is None else joint.accepted(given.value, given.source, accepted)


def as_dict(spec: SweepSpec) -> dict[str, Any]:
    """The specification as JSON has it: lists for tuples. What came with later versions is there if it is not usual."""
    later = {"teacher": ORACLE, "start": None, POINTS: [], **dict.fromkeys(SCALES, ())}
    entries = {**asdict(spec), "seeds": spec.seeds.as_json(), POINTS: joint.as_json(spec.points)}.items()
    return _lists({name: value for name, value in entries if name not in later or value != later[name]})


def from_dict(specification: Mapping[str, Any]) -> SweepSpec:
    """The specification that `as_dict` gave, as it is: what it names need not be there any more.

    Raises:
        KeyError, TypeError, ValueError: it is none.
    """
    values = {
        name: tuple(value) if isinstance(value, list) else value for name, value in specification.items()
    }
    seeds, hyperparameters = Seeds.of(specification["seeds"]), specification["hyperparameters"]
    if seeds is None:
        raise ValueError(f"seeds {shown(specification['seeds'])}")
    numbers = {name: tuple(value) for name, value in hyperparameters.items()}
    start = Source(**specification["start"]) if specification.get("start") else None
    points = joint.from_json(specification.get(POINTS, []))
    return SweepSpec(**{**values, "seeds": seeds, "hyperparameters": numbers, "start": start, POINTS: points})


def accepted_of(table: Mapping[str, Any], prefix: str) -> dict[str, Given | Unchecked]:
    """The settings of a table, each checked alone; dashes and underscores in a key are one."""
    accepted: dict[str, Given | Unchecked] = {}
    for key, value in table.items():
        name, source = key.replace("-", "_"), f"{prefix}{key}"
        if name in accepted:
            raise UserError(f"{source} is given twice, with a dash and with an underscore: give it once")
        if isinstance(value, Mapping) and name not in (*OPTIONS, POINTS):
            near = suggestion(name, OPTIONS)
            raise UserError(f"{prefix}{shown(key)} is no setting{near}: give {', '.join(OPTIONS)}")
        if name in OWNED:
            accepted[name] = said(Unchecked(value, source, key), OPTIONS[name])
        elif name in OPTIONS:
            accepted[name] = Given(accept(OPTIONS[name], value, source), source)
        else:
            accepted[name] = Unchecked(value, source, key)
    return accepted


def _lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _lists(inner) for name, inner in value.items()}
    return list(value) if isinstance(value, tuple) else value
