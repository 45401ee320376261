"""What the lanes of a bench compute (`gpcjax.engine.bench`), compiled when it is first called, or before."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gpcjax.engine import streams
from gpcjax.engine.ahead import Ahead
from gpcjax.engine.correcting import correct
from gpcjax.engine.history import Credit, History
from gpcjax.engine.lanes import Lane, fresh, map_lanes
from gpcjax.engine.lanewise import put, take
from gpcjax.engine.pool import Tier
from gpcjax.engine.single import Elsewhere, info_in
from gpcjax.engine.stepping import propose
from gpcjax.envs.base import begin
from gpcjax.learners.base import Learner, State


class Standing(NamedTuple):
    """Where a pupil stands, as a correction takes it: few arrays, as each costs its share of a call."""

    counts: Int[np.ndarray, " 4"]
    """The pupil's place, its seed, episode and step."""
    now: Float[np.ndarray, " numbers"]
    """Observation and action of the present step, the advice, and the observation at which the policy is looked at."""
    past_obs: Float[np.ndarray, "depth obs"]
    """The steps before, as in `History`; none of them where advice is about the present step."""
    past_action: Float[np.ndarray, "depth action"]


class Known(NamedTuple):
    """What is known of a state, so that nobody has to look at it again."""

    room: bool
    """Whether the next correction surely fits."""
    points: tuple[int, int]
    measured: dict[str, float]


def _wide(leaf: Any, lanes: int, axis: int) -> jax.ShapeDtypeStruct:
    """The shape of so many of a leaf."""
    shape = (lanes, *leaf.shape) if axis == 0 else (*leaf.shape, lanes)
    return jax.ShapeDtypeStruct(shape, leaf.dtype)


class Shapes(NamedTuple):
    """Of one lane."""

    state: list[Any]
    controller: list[Any]


class Programs:
    """Those of benches of one kind, compiled when they are first called, or by `warm_up`.

    Args:
        tier: width and room.
        learner, credit: whose structure all have.
    """

    def __init__(self, tier: Tier, learner: Learner, credit: Credit | None):
        self._tier, self._learner, self._credit = tier, learner, credit
        self._depth = 0 if credit is None else credit.reach
        state = jax.eval_shape(lambda: self._sized(learner.init(streams.first_key(0))))
        controller = jax.eval_shape(learner.controller, state)
        self.state_form = jax.tree.structure(state)
        self._controller_form = jax.tree.structure(controller)
        self._learner_form, self._credit_form = jax.tree.structure(learner), jax.tree.structure(credit)
        self._measures = sorted(jax.eval_shape(learner.measure, state))
        self.shapes = Shapes(jax.tree.leaves(state), jax.tree.leaves(controller))
        self.empty = Ahead(self._empty)
        self.propose = Ahead(self._propose)
        self.correct = Ahead(self._correct, donate=True)
        self.idle = Ahead(self._idle, donate=True)
        self.enter = Ahead(self._put, donate=True)
        self.take = Ahead(lambda leaves, lane: take(leaves, lane, 0))
        self.look = Ahead(self._look)
        self.uncertain = Ahead(self._uncertain)
        self.acts_at = Ahead(self._acts_at)

    def compile(self, before: "Programs | None") -> None:
        """All that a pupil needs who comes here, as the first room's or from that `before`."""
        self.empty.compile()
        state, controller = self._wide
        learner, credit = (jax.tree.map(np.asarray, each) for each in (self._learner, self._credit))
        own = jax.tree.leaves(learner)
        learners = [_wide(leaf, self._tier.lanes, 0) for leaf in own]
        credits = [_wide(leaf, self._tier.lanes, -1) for leaf in jax.tree.leaves(credit)]
        lane, sizes = np.int32(0), (self._learner.obs_size, self._learner.action_size)
        obs, action = map(np.zeros, sizes)
        past = [np.zeros((self._depth, size)) for size in sizes]
        at = Standing(np.zeros(4, np.int64), np.zeros(2 * sum(sizes)), *past)
        for shapes in [self.shapes.state] if before is None else [self.shapes.state, before.shapes.state]:
            self.enter.compile(state, controller, list(shapes), own, lane)
        self.take.compile(state, lane)
        self.propose.compile(controller, np.zeros((len(obs), self._tier.lanes)))
        self.acts_at.compile(controller, lane, obs[:, None])
        self.correct.compile(state, controller, learners, credits, at)
        if self._learner.idle_every:
            seeds, numbers = (np.zeros(self._tier.lanes, kind) for kind in (np.int64, np.int32))
            waiting = np.zeros(self._tier.lanes, bool)
            self.look.compile(state, own, lane)
            self.idle.compile(state, controller, learners, credits, seeds, numbers, numbers, waiting)
        self.uncertain.compile(state, own, lane, obs, action)

    def holds(self, state: State) -> bool:
        """Whether a state has this room."""
        leaves = jax.tree.leaves(state)
        return [np.shape(leaf) for leaf in leaves] == [leaf.shape for leaf in self.shapes.state]

    def known(self, numbers: Float[np.ndarray, " numbers"]) -> Known:
        """What `about` has packed."""
        room, policy, human, *measured = numbers.tolist()
        return Known(bool(room), (int(policy), int(human)), dict(zip(self._measures, measured, strict=True)))

    @property
    def _wide(self) -> tuple[list[jax.ShapeDtypeStruct], list[jax.ShapeDtypeStruct]]:
        """The shapes of a bench: of its state, and of its controller."""
        lanes = self._tier.lanes
        state, controller = self.shapes
        return [_wide(leaf, lanes, 0) for leaf in state], [_wide(leaf, lanes, -1) for leaf in controller]

    # --- traced

    def _empty(self) -> tuple[list[Array], list[Array]]:
        state, controller = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), self._wide)
        return state, controller

    def _sized(self, state: State) -> State:
        return self._learner.resize(state, *self._tier.capacities)

    def _put(self, states: list, controllers: list, state: list, own: list, lane: Array) -> tuple[Any, ...]:
        learner = self._learner_form.unflatten(own)
        one = self._sized(self.state_form.unflatten(state))
        states = put(states, lane, jax.tree.leaves(one), 0)
        controllers = put(controllers, lane, jax.tree.leaves(learner.controller(one)), -1)
        return states, controllers, self.about(learner, one)

    def _propose(self, controller: list, obs: Array) -> Array:
        proposed, finite = propose(self._controller_form.unflatten(controller), obs, jnp.zeros(obs.shape[-1]))
        return jnp.concatenate([proposed, finite[None].astype(proposed.dtype)])

    def _correct(
        self,
        states: list,
        controllers: list,
        learners: list,
        credits: list,
        at: Standing,
    ) -> tuple[Any, ...]:
        width, sizes = self._tier.lanes, (self._learner.obs_size, self._learner.action_size)
        lane, episode, time = (at.counts[index].astype(jnp.int32) for index in (0, 2, 3))
        obs, action, advice, about = jnp.split(at.now, (sizes[0], sum(sizes), sum(sizes) + sizes[1]))
        everywhere = lambda value: jnp.broadcast_to(value[..., None], (*value.shape, width))  # noqa: E731
        block = self._block(states, controllers, learners, credits)
        history = None
        if self._depth:
            history = History(obs=everywhere(at.past_obs), action=everywhere(at.past_action))
        block = dataclasses.replace(
            block,
            env=eqx.tree_at(lambda env: (env.obs, env.time), block.env, (everywhere(obs), everywhere(time))),
            action=everywhere(action),
            episode=everywhere(episode),
            seed=everywhere(at.counts[1]),
            history=history,
        )
        # Of the others, none is advised: their places in the block are the same as this one's, and nobody reads them.
        given = jnp.where(jnp.arange(width)[None] == lane, advice[:, None], 0.0)
        after = correct(block, given)
        before, then = (self._act(leaves, lane, about) for leaves in (controllers, after.controller))
        learner, state = take((block.learner, after.state), lane, 0)
        info = info_in(take(after.log, lane, 0), after.status[lane], self._learner.action_size)
        learned = after.tally.corrections[lane].astype(float)
        packed = jnp.concatenate([learned[None], before, then, self.about(learner, state)])
        return jax.tree.leaves(after.state), jax.tree.leaves(after.controller), info, packed

    def _idle(
        self,
        states: list,
        controllers: list,
        learners: list,
        credits: list,
        seeds: Array,
        episodes: Array,
        times: Array,
        waiting: Array,
    ) -> tuple[Any, ...]:
        block = self._block(states, controllers, learners, credits)
        env = eqx.tree_at(lambda env: env.time, block.env, times)
        block = dataclasses.replace(block, env=env, seed=seeds, episode=episodes, waiting=waiting)
        after = correct(block, jnp.zeros_like(block.action))
        return jax.tree.leaves(after.state), jax.tree.leaves(after.controller), after.status

    def _look(self, states: list, own: list, lane: Array) -> Array:
        return self.about(self._learner_form.unflatten(own), self.state_form.unflatten(take(states, lane, 0)))

    def _act(self, controllers: Any, lane: Array, obs: Array) -> Array:
        controller = self._controller_form.unflatten(take(jax.tree.leaves(controllers), lane, -1))
        return jnp.clip(controller(obs), -1.0, 1.0)

    def _uncertain(self, states: list, own: list, lane: Array, obs: Array, action: Array) -> Array:
        learner = self._learner_form.unflatten(own)
        return learner._uncertainty(self.state_form.unflatten(states), (lane,), obs, action)

    def _acts_at(self, controllers: list, lane: Array, obs: Array) -> Array:
        return jax.vmap(lambda obs: self._act(controllers, lane, obs), in_axes=-1, out_axes=-1)(obs)

    def about(self, learner: Learner, state: State) -> Float[Array, " numbers"]:
        """What is known of a state, packed."""
        moments = 1 if self._credit is None else self._credit.moments
        measured = learner.measure(state)
        numbers = [
            learner.has_room(state, moments),
            *learner.points(state),
            *(measured[name] for name in self._measures),
        ]
        return jnp.stack([jnp.asarray(number, float) for number in numbers])

    def _block(self, states: list, controllers: list, learners: list, credits: list) -> Lane:
        """The bench as the engine's functions know it, at no step."""
        learner, credit = self._learner, self._credit
        lane = fresh(begin((), jnp.zeros(learner.obs_size)), learner, Elsewhere(), jnp.asarray(0), 1, credit)
        width = self._tier.lanes

        def widened(leaf: Any, axis: int) -> Array:
            shape = (width, *leaf.shape) if axis == 0 else (*leaf.shape, width)
            return jnp.broadcast_to(jnp.expand_dims(leaf, axis), shape)

        return dataclasses.replace(
            map_lanes(widened, dataclasses.replace(lane, history=None)),
            learner=self._learner_form.unflatten(learners),
            state=self.state_form.unflatten(states),
            controller=self._controller_form.unflatten(controllers),
            credit=self._credit_form.unflatten(credits),
        )
