"""How names and numbers are written in tables, figures and the HTML report."""

from collections.abc import Sequence

import numpy as np

from gpcjax.describe import Setting
from gpcjax.learners.descriptions import CREDIT
from gpcjax.registry import built_in, find
from gpcjax.report.groups import Group, Study
from gpcjax.report.statistics import Interval
from gpcjax.streams import ASCII
from gpcjax.sweep.labels import known

ABSENT = "-"
STATUS_TEXTS = {"full": "dictionary full", "non-finite": "a number was not finite"}


_SETTINGS: dict[str, Setting] = {
    setting.name: setting
    for kind in ("learner", "teacher")
    for name in built_in(kind)
    for setting in find(kind, name).settings
} | {setting.name: setting for setting in CREDIT}
_SYMBOLS = {name: setting.symbol for name, setting in _SETTINGS.items() if setting.symbol} | {
    "delta": "delta",
    "rate": "gamma",
}
_MEANINGS = {name: setting.text for name, setting in _SETTINGS.items()} | {
    "delta": "distance from its target within which the teacher is silent",
    "rate": "chance of advice at a step",
}
_GREEK = ("alpha", "beta", "gamma", "delta", "sigma", "tau", "nu")


def algorithm(name: str) -> str:
    """As the thesis writes it."""
    return name if (spec := known("learner", name)) is None else spec.title


def drawn_algorithm(name: str) -> str:
    """The same in a legend, where a dollar would begin a formula and an underscore at the front hide the line."""
    label = algorithm(name).replace("$", "\\$")
    return f" {label}" if label.startswith("_") else label


def task(name: str) -> str:
    """A task as a sentence calls it."""
    return name if (spec := known("task", name)) is None else spec.title


def percent(error: float) -> str:
    """A chance: `12.5%`."""
    return f"{100 * error:.6g}%"


def plain_symbol(name: str) -> str:
    """The thesis' symbol of a setting that varies, as text: `l_p`."""
    return _SYMBOLS.get(name, name)


def math_symbol(name: str) -> str:
    """The same for matplotlib: `$l_p$`."""
    symbol = _SYMBOLS.get(name)
    if symbol is None:
        return name
    for letter in _GREEK:
        symbol = symbol.replace(letter, "\\" + letter)
    return f"${symbol}$"


def meaning(name: str) -> str:
    """What a setting that varies is, in words."""
    return _MEANINGS.get(name, name.replace("_", " "))


def point(group: Group) -> str:
    """The settings of the group that vary: `l_p 0.1, l_h 0.2`, or nothing."""
    return ", ".join(f"{plain_symbol(name)} {value:g}" for name, value in group.point.values)


def value(setting: float | None) -> str:
    """The value of a setting, if it has one."""
    return ABSENT if setting is None else f"{setting:g}"


def action(env: str, dimension: int) -> str:
    """What an action dimension (from 0) moves."""
    spec = known("task", env)
    names = () if spec is None else spec.actions
    return names[dimension] if dimension < len(names) else f"action {dimension + 1}"


def runs(study: Study) -> str:
    """How many runs there are of each algorithm: `100 runs`, or `100 runs of GPC and COACH, 20 of GPC-NS`."""
    counts: dict[str, list[str]] = {}
    for algo in study.algorithms:
        numbers = sorted({group.runs for group in study.groups if group.algo == algo and group.runs})
        if numbers:
            shown = f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
            counts.setdefault(shown, []).append(algorithm(algo))
    if not counts:
        return "no run"
    (first, of), *others = counts.items()
    whole = f"{first} run{'' if first == '1' else 's'}"
    return (
        ", ".join([f"{whole} of {listed(of)}", *(f"{n} of {listed(o)}" for n, o in others)])
        if others
        else whole
    )


def listed(names: Sequence[str]) -> str:
    """`a, b and c`."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def return_label(study: Study) -> str:
    """What the return counts, with its unit where it has one."""
    spec = known("task", study.env)
    return f"return ({spec.unit})" if spec is not None and spec.unit else "return"


def places(values: Sequence[float]) -> int:
    """Decimals with which the largest of `values` has three digits or more; one number for a whole column."""
    finite = [abs(value) for value in values if np.isfinite(value)]
    largest = max(finite, default=0.0)
    return 0 if largest >= 100 or largest == 0 else 1 if largest >= 10 else 2 if largest >= 1 else 3


def number(value: float, decimals: int) -> str:
    """`value` with so many decimals; a dash for what does not exist, `never` for what did not happen."""
    if np.isnan(value):
        return ABSENT
    if np.isinf(value):
        return "never"
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0 else text


def interval(interval: Interval, decimals: int) -> str:
    """`12.3 [11.9, 12.8]`; without bounds (one run) only the estimate."""
    estimate, lower, upper = (number(value, decimals) for value in interval)
    return estimate if ABSENT in (lower, upper) else f"{estimate} [{lower}, {upper}]"


_PLAIN = str.maketrans(ASCII)


def printable(text: str, encoding: str | None) -> str:
    """`text` as a stream of this encoding can take it: in ASCII's way of writing, or escaped where there is none."""
    encoding = encoding or "ascii"
    for candidate in (text, text.translate(_PLAIN)):
        try:
            candidate.encode(encoding)
            return candidate
        except UnicodeEncodeError:
            continue
    return text.translate(_PLAIN).encode(encoding, "backslashreplace").decode(encoding)


def plus_minus(mean: float, std: float, decimals: int) -> str:
    """A mean and its standard deviation."""
    return f"{number(mean, decimals)} ± {number(std, decimals)}"


def cut_short(count: int) -> str:
    """So many episodes of a lesson that its task did not end."""
    what = "1 episode that was" if count == 1 else f"{count:,} episodes that were"
    return f"{what} ended before the task did (by a person, a limit of time, or a failure)"
