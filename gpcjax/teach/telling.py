"""What the page is told, as JSON knows it."""

import io
import math
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from gpcjax.allowed import Numbers, OneOf
from gpcjax.describe import LearnerSpec, Setting, TaskSpec
from gpcjax.engine.session import Session
from gpcjax.envs.registry import make_env
from gpcjax.learners.base import Learner, Status
from gpcjax.registry import find
from gpcjax.teach.course import seconds_of
from gpcjax.teach.protocol import Press
from gpcjax.teach.tally import Episode, Tally
from gpcjax.teach.world import makes_pictures

__all__ = [
    "advised_of",
    "axes_of",
    "bounds",
    "described_learner",
    "described_task",
    "episode_of",
    "finite",
    "packed",
]

_KEYS = (("left", "right"), ("down", "up"))
"""Of less and more, for the first and the second dimension of an action of which nothing else is known."""

PICTURE_WIDTH = 600
"""Pixels at most; WebP of that takes 5 ms."""

MAIN = (
    "policy_length_scale",
    "human_length_scale",
    "static_rate",
    "constant_rate",
    "magnitude",
    "learning_rate",
    "beta",
)
"""Settings that the page offers first."""


def described_task(
    task: TaskSpec,
    learner: Learner,
    low_high: Float[np.ndarray, "obs 2"],
    axes: tuple[int, int],
    pictures: bool | None = None,
) -> dict[str, Any]:
    """Of a task; `pictures` is whether any come of one without a scene of ours, which otherwise is what it says."""
    view = task.view
    names = [name for name, _, _ in view.observed] or [
        f"observation {i + 1}" for i in range(learner.obs_size)
    ]
    actions = [_control(task, dim) for dim in range(learner.action_size)]
    env = make_env(task.name)
    shows = makes_pictures(env) if pictures is None else pictures
    scene = view.scene or ("pictures" if shows else "signals")
    return {
        "name": task.name,
        "label": task.title,
        "unit": task.unit,
        "step": seconds_of(task),
        "max_steps": getattr(env, "max_steps", None) or 1000,
        "scene": scene,
        "hint": view.hint,
        "observations": [
            {"name": name, "low": float(low), "high": float(high)}
            for name, (low, high) in zip(names, low_high, strict=True)
        ],
        "actions": actions,
        "axes": list(axes),
    }


def _control(task: TaskSpec, dim: int) -> dict[str, Any]:
    name = task.actions[dim] if dim < len(task.actions) else f"action {dim + 1}"
    if dim < len(task.view.controls):
        control = task.view.controls[dim]
        return {
            "name": name,
            "less": {"key": control.less[0], "words": control.less[1]},
            "more": {"key": control.more[0], "words": control.more[1]},
        }
    less, more = _KEYS[dim] if dim < len(_KEYS) else ("", "")
    return {"name": name, "less": {"key": less, "words": "less"}, "more": {"key": more, "words": "more"}}


def bounds(task: TaskSpec, size: int, tally: Tally) -> Float[np.ndarray, "obs 2"]:
    """Lowest and highest value of each number of an observation: as its view says, or as they were so far."""
    if len(task.view.observed) == size:
        return np.array([(low, high) for _, low, high in task.view.observed])
    seen = np.array(
        [obs for each in (*tally.finished[:1], tally.present) for obs in each.obs] or [[0.0] * size]
    )
    usual = np.array(task.obs_scale if task.obs_scale is not None else [1.0] * size)
    reach = np.maximum(np.abs(seen).max(0) * 1.2, usual)
    return np.stack([-reach, reach], axis=-1)


def axes_of(task: TaskSpec, size: int) -> tuple[int, int]:
    """The two of these many numbers of an observation over which the policy is drawn first; a single one is both."""
    x, y = (min(int(axis), size - 1) for axis in task.view.axes)
    return x, y


def described_learner(name: str, task: TaskSpec, given: Mapping[str, float]) -> dict[str, Any]:
    """Of a learner on a task, with its few main settings: those that were given, else the task's or its own."""
    spec: LearnerSpec = find("learner", name)
    own = {each.name: each.default for each in spec.settings}
    values = {**own, **spec.defaults, **task.presets.get(name, {}), **given}
    if "static_rate" in given:  # beside which it changes nothing
        values.pop("constant_rate", None)
    named = [setting for setting in spec.settings if isinstance(values.get(setting.name), int | float)]
    named.sort(key=lambda setting: MAIN.index(setting.name) if setting.name in MAIN else len(MAIN))
    return {
        "name": name,
        "label": spec.title,
        "settings": [_setting(setting, values[setting.name]) for setting in named[:4]],
    }


def _setting(setting: Setting, value: float) -> dict[str, Any]:
    low = high = None
    match setting.allowed:
        case Numbers() as numbers:
            low = numbers.low if math.isfinite(numbers.low) else None
            high = numbers.high if math.isfinite(numbers.high) else None
        case OneOf(choices=choices):
            real = [each for each in choices if not isinstance(each, str)]
            low, high = min(real), max(real)
    return {
        "name": setting.name,
        "label": setting.name.replace("_", " "),
        "symbol": setting.symbol,
        "value": value,
        "low": low,
        "high": high,
        "text": setting.text,
    }


def episode_of(index: int, episode: Episode) -> dict[str, Any]:
    """Of a finished episode."""
    return {
        "index": index,
        "total": episode.total,
        "steps": episode.length,
        "corrections": episode.corrections,
        "mode": "teach",
        "why": episode.why,
    }


def frame_of(
    number: int, session: Session, present: Episode, episode: int, mode: str, late: float
) -> dict[str, Any]:
    """Of the present step of a session."""
    obs, action = session.latest
    return {
        "type": "frame",
        "n": number,
        "episode": episode,
        "step": present.length,
        "obs": obs,
        "action": action,
        "total": present.total,
        "sigma": None,
        "prior": None,
        "mode": mode,
        "late": round(late, 2),
    }


def advised_of(press: Press, done: Any) -> dict[str, Any]:
    """Of an advice that was learned; what a learner does not know is null."""
    info, dim = done.info, press.dim
    numbers = {
        "rate": info.rate,
        "sigma_human": info.sigma_human,
        "sigma_policy": info.sigma_policy,
    }
    full = bool(np.asarray(info.full)[dim]) and not bool(np.asarray(info.replaced)[dim])
    status = Status.FULL if full else Status(int(info.status))
    return {
        "id": press.id,
        "dim": dim,
        "h": press.h,
        "obs": done.obs.tolist(),
        "before": done.before,
        "after": done.after,
        "status": status.label,
        **{name: finite(np.asarray(value)[dim]) for name, value in numbers.items()},
    }


def packed(number: int, image: UInt8[np.ndarray, "height width 3"]) -> bytes:
    """A picture as the page takes it: the number of its frame, then WebP."""
    from PIL import Image

    picture = Image.fromarray(image)
    if picture.width > PICTURE_WIDTH:
        picture = picture.resize((PICTURE_WIDTH, round(picture.height * PICTURE_WIDTH / picture.width)))
    buffer = io.BytesIO()
    picture.save(buffer, "WEBP", quality=75, method=0)
    return struct.pack("<I", number) + buffer.getvalue()


def finite(value: Any) -> float | None:
    """A number as JSON knows it: None for one that is not finite."""
    number = float(value)
    return number if math.isfinite(number) else None
