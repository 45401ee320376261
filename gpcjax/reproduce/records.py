"""What the illustrative figures show: named arrays, and the one .npz file that holds them all. Loads no jax.

Angles are in rad, angular velocities in rad/s; actions, their uncertainties and learning rates in units of the
normalised action, [-1, 1]. Advice is -1, 0 or 1.
"""

import io
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from gpcjax.sweep.atomic import write_atomic

Text = Shaped[np.ndarray, "..."]
"""Strings."""


class Hyperparameters(NamedTuple):
    """Fig. 2.2: one process on the same points with poor (0) and with fitted (1) hyperparameters."""

    points: Float[np.ndarray, " n"]
    targets: Float[np.ndarray, " n"]
    x: Float[np.ndarray, " grid"]
    truth: Float[np.ndarray, " grid"]
    """The function that the targets were drawn from."""
    mean: Float[np.ndarray, "2 grid"]
    deviation: Float[np.ndarray, "2 grid"]
    """Standard deviation of a new target, noise included."""
    variance: Float[np.ndarray, " 2"]
    length_scale: Float[np.ndarray, " 2"]
    noise: Float[np.ndarray, " 2"]
    """Variance."""
    log_likelihood: Float[np.ndarray, " 2"]
    """Log marginal likelihood, in nats."""


class Situations(NamedTuple):
    """Fig. 3.2: GPC with one state dimension, before each of four steps at x = 0: more, more, and twice no advice."""

    x: Float[np.ndarray, " states"]
    policy: Float[np.ndarray, "4 states"]
    sigma_policy: Float[np.ndarray, "4 states"]
    actions: Float[np.ndarray, " actions"]
    sigma_human: Float[np.ndarray, "4 actions"]
    """sigma_h at (0, a)."""
    action: Float[np.ndarray, " 4"]
    """The action that is executed at x = 0."""
    sigma_human_there: Float[np.ndarray, " 4"]
    """sigma_h at (0, action)."""
    advice: Float[np.ndarray, " 4"]
    rate: Float[np.ndarray, " 4"]
    """Learning rate of the correction; 0 without advice."""
    parameters: Text


class Plane(NamedTuple):
    """Figs. 3.3 and 5.3: what a GPC learner holds over the pendulum's plane, rows along the angular velocity."""

    theta: Float[np.ndarray, " angles"]
    """0 is upright."""
    theta_dot: Float[np.ndarray, " velocities"]
    policy: Float[np.ndarray, "velocities angles"]
    sigma_policy: Float[np.ndarray, "velocities angles"]
    sigma_human: Float[np.ndarray, "velocities angles"]
    """sigma_h at (s, P(s))."""
    rate: Float[np.ndarray, "velocities angles"]
    """Learning rate (3.5) of a correction there."""
    dictionary: Float[np.ndarray, "points 2"]
    """(theta, theta_dot) of the points that the policy holds."""
    advised: Float[np.ndarray, "corrections 2"]
    """(theta, theta_dot) of all corrections, also those that SPARS replaced since."""
    returns: Float[np.ndarray, " episodes"]
    """Return of each episode of the teaching."""
    settings: Text
    parameters: Text


class Sparsification(NamedTuple):
    """Fig. 3.4: repeated advice "more" at one state, with plain appending (0) and with SPARS (1)."""

    action: Float[np.ndarray, "2 advices"]
    """Executed, before the advice."""
    target: Float[np.ndarray, "2 advices"]
    """a_n, what is stored: the action moved by the learning rate."""
    after: Float[np.ndarray, "2 advices"]
    """The action once the advice is learned."""
    rate: Float[np.ndarray, "2 advices"]
    points: Int[np.ndarray, "2 advices"]
    """Points of the policy after the advice."""
    state: Float[np.ndarray, " obs"]
    parameters: Text


class Erroneous(NamedTuple):
    """Fig. 5.9: one erroneous advice in a run of correct ones at one state.

    By algorithm, and by length-scale l_h of the human model, a short one and a long one. A teacher says "more" until
    the action is within its tolerance of the target; one of its advices is inverted. Entries after its last advice
    are NaN.
    """

    algorithms: Text
    length_scales: Float[np.ndarray, " 2"]
    """l_h, short and long."""
    wrong: Int[np.ndarray, ""]
    """Number of the inverted advice, from 1."""
    action: Float[np.ndarray, "algos 2 advices+1"]
    """Before the first advice and after each."""
    advice: Float[np.ndarray, "algos 2 advices"]
    rate: Float[np.ndarray, "algos 2 advices"]
    sigma_policy: Float[np.ndarray, "algos 2 advices"]
    sigma_human: Float[np.ndarray, "algos 2 advices"]
    samples: Float[np.ndarray, "algos 2"]
    """Correct advices until the action is back where the error met it."""
    thesis_length_scales: Float[np.ndarray, " algos"]
    """l_h of Table 5.2."""
    scanned_length_scales: Float[np.ndarray, " scanned"]
    scanned_wrong: Int[np.ndarray, " wrongs"]
    scanned_samples: Float[np.ndarray, "algos scanned wrongs"]
    """`samples` over l_h and the number of the inverted advice; NaN where the teacher was silent before it."""
    target: Float[np.ndarray, ""]
    tolerance: Float[np.ndarray, ""]
    state: Float[np.ndarray, " obs"]
    parameters: Text
    """A row for each algorithm; but for l_h."""


class Repetitions(NamedTuple):
    """What claims about the illustrations are tested on: numbers of many runs or draws, of which the figures show one.

    The first five speak of GPC on the pendulum (`Plane`); a pair is what is compared. Values that a run does not
    have are NaN.
    """

    seeds: Int[np.ndarray, " seeds"]
    rest: Float[np.ndarray, "2 seeds"]
    """Mean sigma_h of the taught policy's actions around the upright rest (0), and elsewhere (1); late."""
    advised: Float[np.ndarray, "2 seeds"]
    """Mean sigma_p where advice was given (0), and over the whole plane (1); late."""
    unconverged: Float[np.ndarray, "2 2 seeds"]
    """Mean sigma_h at visited states whose action is farther than delta from its target (0), or nearer (1); early (0)
    and late (1)."""
    behind: Float[np.ndarray, "2 seeds"]
    """As `Sparsification`, but of mixed advice: largest distance of the action from the average of all targets with
    plain appending (0), from the last target with SPARS (1)."""
    algorithms: Text
    consistent: Float[np.ndarray, "algos 2 seeds advices"]
    """Learning rate at each of several advices at one state that are all the same (0), or alternate (1)."""
    compensated: Text
    """Algorithms of `samples`."""
    length_scales: Float[np.ndarray, " 2"]
    """l_h of `samples`, short and long."""
    samples: Float[np.ndarray, "compensated 2 seeds"]
    """As in `Erroneous`, for other targets and numbers of the inverted advice."""


class Illustrations(NamedTuple):
    """All of them, in the thesis' order."""

    hyperparameters: Hyperparameters
    """Fig. 2.2"""
    situations: Situations
    """Fig. 3.2"""
    early: Plane
    """Fig. 3.3"""
    sparsification: Sparsification
    """Fig. 3.4"""
    late: Plane
    """Fig. 5.3"""
    erroneous: Erroneous
    """Fig. 5.9"""
    repetitions: Repetitions


def write(path: Path, illustrations: Illustrations) -> None:
    """Writes one compressed .npz; `path` holds either its old content or all of the new one.

    Raises:
        OSError: the folder is missing or cannot be written.
    """
    arrays = {
        f"{name}.{field}": value
        for name, record in illustrations._asdict().items()
        for field, value in record._asdict().items()
    }
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    write_atomic(path, stream.getvalue())


def read(path: Path) -> Illustrations:
    """What `write` stored.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no such file, or one of another version.
    """
    try:
        with np.load(path) as arrays:
            records = {
                name: kind(**{field: arrays[f"{name}.{field}"] for field in kind._fields})
                for name, kind in Illustrations.__annotations__.items()
            }
    except (KeyError, ValueError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} does not hold these illustrations: compute them anew ({error})") from None
    return Illustrations(**records)


def stored(path: Path) -> Illustrations | None:
    """What `read` gives; None where there is no such file, or one of another version: it is computed anew."""
    try:
        return read(path)
    except (OSError, ValueError):
        return None
