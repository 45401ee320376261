"""The settings of a learner or a teacher of a person's own, and which names they can have. Loads no jax."""

import dataclasses
import inspect
import numbers
from collections.abc import Callable
from typing import Any

from gpcjax.allowed import FINITE, Numbers
from gpcjax.describe import Setting
from gpcjax.errors import UserError

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
