"""The illustrations again, for many seeds: what claims about them are tested on."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from gpcjax.engine import streams
from gpcjax.engine.lanes import Lane
from gpcjax.envs.base import Env
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.learners.base import Learner
from gpcjax.learners.factory import make_learner
from gpcjax.learners.gpc import GPC, GPCState
from gpcjax.reproduce.probing import angles_of, as_gpc, look
from gpcjax.reproduce.records import Repetitions

AROUND_REST = (0.4, 1.5)
"""Half axes of what is around the upright rest: rad and rad/s."""

DELTA = 0.05
"""Distance from the target within which an action has converged: the teacher's default."""

STARTS, EVERY = 5, 5
"""Episodes of a taught policy whose states are looked at, and each how manieth of them."""

ADVICES, HISTORY, MIXED = 6, 3, 12
"""Advices that are the same or alternate, so few that the action stays off its bounds; before them, of either sign, at
most; and of mixed advice for SPARS."""

PATIENCE = 40
"""Advices within which an erroneous one should be made good; one that is not counts as that many."""


def repetitions(
    early: Sequence[Lane], late: Sequence[Lane], length_scales: tuple[float, float]
) -> Repetitions:
    """All numbers, for a seed a lane: of the same runs after a few episodes and after many."""
    seeds = np.arange(len(late))
    late_maps = [_over_plane(lane) for lane in late]
    algorithms, compensated = ("gpc", "gpc-ns", "coach"), ("gpc", "gpc-ns")
    return Repetitions(
        seeds=seeds,
        rest=np.array([maps[0] for maps in late_maps]).T,
        advised=np.array([maps[1] for maps in late_maps]).T,
        unconverged=np.array([[_unconverged(lane) for lane in lanes] for lanes in (early, late)]).swapaxes(
            1, 2
        ),
        behind=np.array([_behind(sparsify, seeds) for sparsify in (False, True)]),
        algorithms=np.array(algorithms),
        consistent=np.array([_consistent(algo, seeds) for algo in algorithms]),
        compensated=np.array(compensated),
        length_scales=np.array(length_scales),
        samples=np.array([[_samples(algo, scale, seeds) for scale in length_scales] for algo in compensated]),
    )


def _over_plane(lane: Lane) -> tuple[tuple[float, float], tuple[float, float]]:
    """Mean sigma_h at rest and elsewhere, and mean sigma_p where advice was given and over the plane."""
    learner, state = as_gpc(lane.learner), lane.state
    theta, theta_dot = np.linspace(-np.pi, np.pi, 41), np.linspace(-8.0, 8.0, 33)
    grid = _observed(theta, theta_dot[:, None])
    seen = look(learner, state, grid.reshape(-1, 3))
    sigma_policy, sigma_human = (
        seen[name].reshape(grid.shape[:2]) for name in ("sigma_policy", "sigma_human")
    )
    rest = (theta[None] / AROUND_REST[0]) ** 2 + (theta_dot[:, None] / AROUND_REST[1]) ** 2 < 1
    places = angles_of(state.human)
    # Repeated to a fixed number: one compilation for all runs, and the mean over whole rounds is the same.
    advised = np.asarray(_sigmas_of_policy(learner, state, jnp.asarray(_observed(*_padded(places).T))))
    return (
        (float(sigma_human[rest].mean()), float(sigma_human[~rest].mean())),
        (float(advised[: len(places)].mean()), float(sigma_policy.mean())),
    )


def _observed(theta: np.ndarray, theta_dot: np.ndarray) -> Float[np.ndarray, "*places 3"]:
    theta, theta_dot = np.broadcast_arrays(theta, theta_dot)
    return np.stack([np.cos(theta), np.sin(theta), theta_dot], -1)


def _padded(places: Float[np.ndarray, "places 2"]) -> Float[np.ndarray, "padded 2"]:
    """To a power of two, with the first place."""
    size = 1 << (len(places) - 1).bit_length()
    return np.concatenate([places, np.repeat(places[:1], size - len(places), axis=0)])


@eqx.filter_jit
def _sigmas_of_policy(
    learner: GPC, state: GPCState, observations: Float[Array, "places obs"]
) -> Float[Array, " places"]:
    policy = jax.tree.map(lambda leaf: leaf[0], state.policy)
    # One place at a time: all matrices of all places at once would take gigabytes.
    return lax.map(lambda obs: learner.policy.uncertainty(policy, (), obs), observations)


def _unconverged(lane: Lane) -> tuple[float, float]:
    """Mean sigma_h where the policy's action is not at its target yet, and where it is."""
    env, expert = make_env("pendulum"), make_expert("pendulum", "gpc")
    learner = as_gpc(lane.learner)
    observations = _visited(env, learner, lane.state)
    seen = look(learner, lane.state, observations)
    target = jax.vmap(expert, in_axes=-1, out_axes=-1)(observations.T)[0]
    far = np.abs(np.clip(np.asarray(seen["policy"]), -1.0, 1.0) - np.asarray(target)) > DELTA
    sigma = np.asarray(seen["sigma_human"])
    return tuple(float(sigma[mask].mean()) if mask.any() else np.nan for mask in (far, ~far))  # pyright: ignore[reportReturnType]


@eqx.filter_jit
def _visited(env: Env, learner: GPC, state: GPCState) -> Float[Array, "places obs"]:
    """Some of the states that the policy meets from a few starts."""

    def episode(seed: Int[Array, ""]) -> Float[Array, "steps obs"]:
        def step(before, _):
            return env.step(before, learner.act(state, before.obs)), before.obs

        _, observations = lax.scan(step, env.reset(streams.start_key(seed, 0)), None, 200)
        return observations[::EVERY]

    # Starts that no teaching had: seeds far from those of the runs.
    return lax.map(episode, 1000 + jnp.arange(STARTS)).reshape(-1, 3)


def _taught(
    learner: Learner,
    obs: Float[np.ndarray, "runs obs"],
    advice: Float[np.ndarray, "runs advices"],
    target: Float[np.ndarray, " runs"] | float = np.nan,
) -> dict[str, Float[np.ndarray, "runs patience"]]:
    """Advice at one state, for each run: the action that each one met, whether it was given, and its learning rate.

    The teacher is silent while an action is within `DELTA` of the target, or above; NaN is no target. After the last
    advice there is none, up to `PATIENCE`: so all that is asked of a learner here is one program.
    """
    padded = np.pad(advice, ((0, 0), (0, PATIENCE - advice.shape[1])))
    given = obs, padded, np.broadcast_to(target, len(obs))
    return {name: np.asarray(values) for name, values in _run(learner, *map(jnp.asarray, given)).items()}


@eqx.filter_jit
def _run(
    learner: Learner,
    obs: Float[Array, "runs obs"],
    advice: Float[Array, "runs patience"],
    target: Float[Array, " runs"],
) -> dict[str, Array]:
    def run(given: tuple[Array, Array, Array]) -> dict[str, Array]:
        obs, advice, target = given

        def one(state, advice):
            action = learner.act(state, obs)
            says = ~(target - action[0] < DELTA)
            state, info = learner.correct(state, obs, action, jnp.where(says, advice, 0.0)[None])
            return state, {"action": action[0], "given": says, "rate": info.rate[0]}

        return lax.scan(one, learner.init(), advice)[1]

    return lax.map(run, (obs, advice, target))


def _behind(sparsify: bool, seeds: Int[np.ndarray, " seeds"]) -> Float[np.ndarray, " seeds"]:
    """How far the action is at most from what Fig. 3.4 says it follows, under advice of which a fifth is "less"."""
    learner = make_learner("gpc", "cartpole", capacity=PATIENCE, sparsify=sparsify)
    draws = [np.random.default_rng([seed, 0]) for seed in seeds]
    obs = np.array([_cartpole_state(random) for random in draws])
    advice = np.array([np.where(random.uniform(size=MIXED) < 0.2, -1.0, 1.0) for random in draws])
    rows = _taught(learner, obs, advice)
    met, after = rows["action"][:, :MIXED], rows["action"][:, 1 : MIXED + 1]
    targets = met + rows["rate"][:, :MIXED] * advice
    followed = targets if sparsify else targets.cumsum(axis=1) / np.arange(1, MIXED + 1)
    # The action is clipped; what it follows is not.
    return np.abs(after - followed.clip(-1.0, 1.0)).max(axis=1)


def _cartpole_state(random: np.random.Generator) -> Float[np.ndarray, " 4"]:
    """Position (m), its velocity (m/s), angle (rad) and its velocity (rad/s) of a cart-pole that is still balanced."""
    return random.uniform(-1.0, 1.0, 4) * (1.0, 1.0, 0.1, 0.5)


def _consistent(algo: str, seeds: Int[np.ndarray, " seeds"]) -> Float[np.ndarray, "2 seeds advices"]:
    """Rates under advice that stays the same and that alternates, at a state of the cart-pole with a short past."""
    options: dict[str, Any] = {} if algo == "coach" else {"capacity": PATIENCE}  # COACH has no dictionary
    learner = make_learner(algo, "cartpole", **options)
    draws = [np.random.default_rng([seed, 1]) for seed in seeds]
    obs = np.array([_cartpole_state(random) for random in draws])
    past = np.array([random.choice([-1.0, 1.0], HISTORY) for random in draws])
    past[np.arange(HISTORY) < np.array([random.integers(HISTORY + 1) for random in draws])[:, None]] = 0.0
    first = np.array([random.choice([-1.0, 1.0]) for random in draws])[:, None]
    signs = np.ones(ADVICES), (-1.0) ** np.arange(ADVICES)
    given = [np.concatenate([past, first * sign], axis=1) for sign in signs]
    return np.stack(
        [_taught(learner, obs, advice)["rate"][:, HISTORY : HISTORY + ADVICES] for advice in given]
    )


def _samples(algo: str, length_scale: float, seeds: Int[np.ndarray, " seeds"]) -> Float[np.ndarray, " seeds"]:
    """Right advices until the action is back where an inverted one met it; NaN where the teacher was silent by then."""
    learner = make_learner(algo, "cartpole", capacity=PATIENCE, human_length_scale=length_scale)
    draws = [np.random.default_rng([seed, 2]) for seed in seeds]
    target = np.array([random.uniform(0.8, 1.0) for random in draws])
    wrong = np.array([random.integers(1, 4) for random in draws])
    # "More" again and again, but for one that is inverted (from 0).
    advice = np.where(np.arange(PATIENCE) == wrong[:, None], -1.0, 1.0)
    rows = _taught(learner, np.zeros((len(seeds), learner.obs_size)), advice, target)
    actions, advised = rows["action"], rows["given"]
    samples = np.full(len(seeds), np.nan)
    for run, place in enumerate(wrong):
        if advised[run, place]:
            back = np.flatnonzero(actions[run, place + 2 :] >= actions[run, place])
            samples[run] = back[0] + 1 if back.size else PATIENCE
    return samples
