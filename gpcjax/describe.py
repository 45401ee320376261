"""What stands behind a name: descriptions of tasks, learners and teachers, as data. Standard library only, no jax.

Whatever names a task, a learner or a teacher reads its description (`gpcjax.registry.find`); nothing else knows the
list of them. A description is frozen; `make` and the experts are texts "module:attribute" that are imported on demand,
so that naming what is built in loads nothing that computes.
"""

import dataclasses
import inspect
import numbers
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from gpcjax.allowed import FINITE, Allowed, Numbers
from gpcjax.errors import UserError

Make = str | Callable[..., Any]
"""What makes a thing: "module:attribute", or the function or class itself."""


@dataclass(frozen=True)
class Setting:
    """A hyperparameter, once: flag, TOML key, help, bounds and messages come from here.

    | Field      | Meaning                                                                                     |
    |------------|---------------------------------------------------------------------------------------------|
    | `name`     | the TOML key and, with dashes, the flag                                                     |
    | `symbol`   | of the thesis, or of where it comes from; the name if there is none                          |
    | `allowed`  | its values                                                                                  |
    | `text`     | what it is, for the help                                                                    |
    | `default`  | where neither a person nor a preset gives it; None leaves it out                             |
    | `compiled` | what of it a compiled program depends on: nothing, whether it is "given", whether it is     |
    |            | "nonzero", or its "value"                                                                   |
    | `uncertain` | it concerns learners alone that know how uncertain they are                                |
    """

    name: str
    symbol: str
    allowed: Allowed
    text: str
    default: float | None = None
    compiled: Literal["no", "given", "nonzero", "value"] = "no"
    uncertain: bool = False

    @property
    def kind(self) -> type:
        """The type of one value."""
        return int if isinstance(self.allowed, Numbers) and self.allowed.whole else float

    def in_program(self, value: float | None) -> float | bool | None:
        """What a compiled program depends on, where the setting has this value, or none."""
        match self.compiled:
            case "given":
                return value is not None
            case "nonzero":
                return bool(value)
            case "value":
                return value
        return None


@dataclass(frozen=True)
class Column:
    """A measurement that a learner adds to the rows of an episode; null for all others.

    | Field   | Meaning                                             |
    |---------|-----------------------------------------------------|
    | `name`  | of the column, and of the entry in `Learner.measure` |
    | `type`  | "float" or "int"                                    |
    | `text`  | what it is                                          |
    """

    name: str
    type: Literal["float", "int"]
    text: str


Key = Literal["left", "right", "up", "down"]
"""An arrow of a keyboard, a touch screen or a gamepad."""


@dataclass(frozen=True)
class Control:
    """How a person says less or more of one dimension of an action.

    | Field          | Meaning                                                    |
    |----------------|------------------------------------------------------------|
    | `less`, `more` | which arrow means it ("left"), and what it does in words   |
    """

    less: tuple[Key, str]
    more: tuple[Key, str]


@dataclass(frozen=True)
class View:
    """What a person sees of a task while teaching it (`gpcjax teach`).

    | Field      | Meaning                                                                                     |
    |------------|---------------------------------------------------------------------------------------------|
    | `observed` | name, lowest and highest value of each number of an observation, as axes show it             |
    | `controls` | of each dimension of an action                                                              |
    | `scene`    | what the page draws of an observation; without one, pictures that the task makes, or numbers |
    | `axes`     | the two numbers of an observation over which the policy is drawn first                      |
    | `hint`     | what is to be reached, in a short sentence                                                  |
    """

    observed: tuple[tuple[str, float, float], ...] = ()
    controls: tuple[Control, ...] = ()
    scene: Literal["", "cartpole", "mountaincar", "pendulum"] = ""
    axes: tuple[int, int] = (0, 1)
    hint: str = ""


@dataclass(frozen=True)
class TaskSpec:
    """A task.

    | Field          | Meaning                                                                                 |
    |----------------|-----------------------------------------------------------------------------------------|
    | `name`         | under which it is asked for, and its results are kept                                   |
    | `make`         | makes it: an `Env`, a `HostEnv`, or an environment of brax or gymnasium                  |
    | `experts`      | expert name -> "module:function", a function, the folder of a saved policy, or a tuple    |
    |                | (what makes it, its arguments...); the default comes first                              |
    | `label`, `unit` | as reports write it, and what its return counts                                        |
    | `actions`      | what the dimensions of an action move, where there are several                          |
    | `episodes`     | default length of a sweep                                                               |
    | `max_capacity` | default bound of a dictionary's points                                                  |
    | `on_host`      | simulated there: a step takes tens of microseconds, whatever is compiled                |
    | `sizes`        | of an observation and of an action; None asks the task                                  |
    | `time_step`    | seconds of a step; None where a task has no unit of time: then delays are in steps      |
    | `obs_scale`    | how large each number of an observation usually is; None says nothing                   |
    | `presets`      | learner name -> keyword arguments of what makes it                                      |
    | `view`         | what a person sees who teaches it                                                       |
    """

    name: str
    make: Make
    experts: Mapping[str, Any] = field(default_factory=dict, hash=False)
    label: str = ""
    unit: str = ""
    actions: tuple[str, ...] = ()
    episodes: int = 30
    max_capacity: int = 1024
    on_host: bool = False
    sizes: tuple[int, int] | None = None
    time_step: float | None = None
    obs_scale: tuple[float, ...] | None = None
    presets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, hash=False)
    view: View = View()

    @property
    def title(self) -> str:
        """As reports write it."""
        return self.label or self.name

    @property
    def seconds(self) -> float:
        """Of a step; 1 where a task has no unit of time, so that delays are in steps."""
        return 1.0 if self.time_step is None else self.time_step


@dataclass(frozen=True)
class LearnerSpec:
    """A learner.

    | Field        | Meaning                                                                              |
    |--------------|--------------------------------------------------------------------------------------|
    | `name`       | under which it is asked for, and its results are kept                                |
    | `make`       | makes it, from `obs_size`, `action_size`, settings and options by name                |
    | `settings`   | numbers that a sweep may vary                                                        |
    | `options`    | further keyword arguments of `make`, which presets and Python may give                |
    | `needs`      | those of them that a preset of the task must give, as there is no default              |
    | `columns`    | what it measures beside what is measured of all                                      |
    | `dictionary` | it holds points: it lives in blocks of growing capacity, and takes the options of one |
    | `uncertain`  | it knows how uncertain it is (sigma_h), so that a teacher may wait for that           |
    | `normalises` | it finds out how large observations are: what a task says of that is not for it       |
    | `label`      | as reports write it                                                                  |
    | `defaults`   | values where the task has no preset                                                  |
    """

    name: str
    make: Make
    settings: tuple[Setting, ...] = ()
    options: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    columns: tuple[Column, ...] = ()
    dictionary: bool = False
    uncertain: bool = False
    normalises: bool = False
    label: str = ""
    defaults: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @property
    def title(self) -> str:
        """As reports write it."""
        return self.label or self.name


@dataclass(frozen=True)
class TeacherSpec:
    """A teacher.

    | Field          | Meaning                                                                      |
    |----------------|------------------------------------------------------------------------------|
    | `name`         | under which it is asked for                                                  |
    | `make`         | makes it, from its settings by name                                          |
    | `settings`     | numbers that a sweep may vary                                                |
    | `needs_expert` | it aims at the actions of an expert                                          |
    | `label`        | as reports write it                                                          |
    | `action_size`  | of the tasks that it teaches; None is any                                    |
    | `live`         | advises while it watches: no sweep can ask it, its rows come from `gpcjax teach` |
    """

    name: str
    make: Make
    settings: tuple[Setting, ...] = ()
    needs_expert: bool = True
    label: str = ""
    action_size: int | None = None
    live: bool = False

    @property
    def title(self) -> str:
        """As reports write it."""
        return self.label or self.name


Spec = TaskSpec | LearnerSpec | TeacherSpec


OF_EVERY_SWEEP = frozenset(
    "env algo teacher error seeds episodes oracle delta rate rate_schedule sparsify on_full max_capacity out jobs "
    "scaling human_scaling rate_from keep keep_at checkpoint start time_step credit credit_longest credit_shape".split()
)
"""Names of settings that no learner and no teacher can have for its own."""

ELSEWHERE = frozenset("points quick engine address shard executor".split())
"""Names that mean something else where settings are given: a setting of such a name could not be."""

COLUMNS = frozenset(
    "episode return length corrections mean_rate asked chance policy_points human_points clipped full status "
    "step action_dim sigma_policy sigma_human appended replaced advice_rate "
    "kind card arrays policy learner state".split()
)
"""Names of columns of every sweep's tables, beside those of `OF_EVERY_SWEEP` and `seed`: nothing else can have them."""


REPORTED = frozenset(
    "runs stopped unfinished steps met_full never best tied oracle_return oracle_std idle_return idle_std "
    "first second pairs excludes_zero".split()
) | {
    f"{name}{bound}"
    for name in ("final_return", "area", "episodes_to_90", "corrections", "area_difference")
    for bound in ("", "_lower", "_upper")
}
"""Names of columns of a report's tables, in which a setting that varies has one, too."""


def is_column(name: str) -> bool:
    """Whether the tables of every sweep may have a column of this name."""
    return name in COLUMNS or name in OF_EVERY_SWEEP or name == "seed"


def check_name(source: str, name: str) -> None:
    """Whether a learner or a teacher may have a setting of this name; `source` begins the message.

    Raises:
        UserError: something else of every sweep, or of every report, has it.
    """
    for names, what in (
        (OF_EVERY_SWEEP | ELSEWHERE, "setting of every sweep"),
        ({*COLUMNS, "seed"}, "column of every sweep"),
        (REPORTED, "column of every report"),
    ):
        if name in names:
            raise UserError(f"{source} is a {what}, give it another name")


def compiled_if_whole(setting: Setting) -> Setting:
    """The setting, compiled in if its values are whole numbers: these are static fields (`gpcjax.fixed`)."""
    whole = setting.kind is int and setting.compiled == "no"
    return dataclasses.replace(setting, compiled="value") if whole else setting


def settings_from(
    source: str, found: Callable[..., Any], others: tuple[str, ...] = ()
) -> tuple[Setting, ...]:
    """The arguments with a number as their default, but for `others`, of what makes a learner or a teacher.

    Whole numbers are compiled in; all others may be data of one program (`gpcjax.making.told_apart`).

    Raises:
        UserError: one of them has a name that it cannot have (`check_name`); `source` begins the message.
    """
    fields = {each.name: each.default for each in getattr(found, "__dataclass_fields__", {}).values()}
    settings = []
    for name, parameter in inspect.signature(found).parameters.items():
        default = fields.get(name, parameter.default)
        if name in others or not isinstance(default, numbers.Real) or isinstance(default, bool):
            continue
        check_name(f"{source}: its argument {name}", name)
        whole = isinstance(default, numbers.Integral)
        settings.append(
            Setting(
                name,
                "",
                Numbers(whole=True) if whole else FINITE,
                name.replace("_", " "),
                default=int(default) if whole else float(default),
                compiled="value" if whole else "no",
            )
        )
    return tuple(settings)
