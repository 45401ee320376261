"""A task, a learner or a teacher of a person's own is traced once, by itself, before a program is made of it.

What it gets wrong is told in its own words then, and not in those of a program of many lanes.
"""

import dataclasses
from collections.abc import Callable, Collection, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gpcjax._x64 import seeded_key
from gpcjax.allowed import shown
from gpcjax.engine.lanes import Start, memory_of
from gpcjax.envs.base import Env, started
from gpcjax.envs.host import HostEnv
from gpcjax.errors import ForeignError, UserError
from gpcjax.fixed import fixed
from gpcjax.learners.base import Learner
from gpcjax.learners.forms import check, check_learned, does_not_fit, form, worded
from gpcjax.moment import Moment
from gpcjax.own_settings import OF_EVERY_SWEEP, is_column
from gpcjax.registry import find
from gpcjax.sweep.plan import Cell
from gpcjax.teachers.base import Teacher

T = TypeVar("T")


def rehearse_learner(name: str, learner: Learner) -> None:
    """Traces what a learner does in a sweep.

    Raises:
        ForeignError: one of its methods fails, or gives something of another shape or type than it should.
        UserError: a method of ours that it calls refuses what it is given.
    """
    source = f"algo {name}: {type(learner).__name__}"
    here, learner = _moment(learner.obs_size, learner.action_size), _numbers(source, learner)
    state = _traced(f"{source}.init", lambda learner: learner.init(_key()), learner)
    if any(form(leaf) is None for leaf in jax.tree.leaves(state)):
        raise does_not_fit(f"{source}.init", f"the state is {worded(state)}, it should be made of arrays")
    _refuse_keys(f"{source}.init: state", state)

    def proposes(learner: Learner, state: Any, obs: Any) -> Any:
        return learner.controller(state)(obs)

    def learns(learner: Learner, state: Any, moment: Moment, advice: Any) -> Any:
        return learner.learn(state, moment, advice, _key())

    action = _traced(f"{source}.propose", proposes, learner, state, here.obs)
    check(f"{source}.propose", "an action", action, here.action)
    if learner.joint:
        given = _traced(f"{source}.learn", learns, learner, state, here, here.action)
        check_learned(f"{source}.learn", given, state, here.action)
    if learner.idle_every:
        after = _traced(f"{source}.idle", lambda learner, state: learner.idle(state, _key()), learner, state)
        check(f"{source}.idle", "the new state", after, state)
    measured = _traced(f"{source}.measure", lambda learner, state: learner.measure(state), learner, state)
    if not isinstance(measured, Mapping) or any(
        form(each) is None or each.shape for each in measured.values()
    ):
        raise does_not_fit(
            f"{source}.measure", f"it gives {worded(measured)}, it should give a number for each name"
        )
    for each in measured:
        if not isinstance(each, str) or not each.isidentifier():
            raise UserError(f"{source}.measure: {shown(each)} can be no column, give a name like n_updates")
        if is_column(each):
            what = "setting" if each in OF_EVERY_SWEEP else "column"
            raise UserError(f"{source}.measure: {each} is a {what} of every sweep, give it another name")


def check_columns(cell: Cell, learner: Learner, varying: Collection[str]) -> None:
    """Whether what a learner measures can have columns beside those of the settings that vary.

    Raises:
        UserError: one of these has the same name.
    """
    if type(learner).measure is Learner.measure:
        return
    measured = jax.eval_shape(lambda: learner.measure(learner.init(_key())))
    if twice := sorted(measured.keys() & set(varying)):
        own = any(twice[0] == setting.name for setting in find("learner", cell.algo).settings)
        what = "a setting of this learner that varies here" if own else "a column of this sweep"
        raise UserError(
            f"algo {cell.algo}: {type(learner).__name__}.measure: {twice[0]} is {what}, give it another name"
        )


def rehearse_teacher(name: str, teacher: Teacher, obs_size: int, action_size: int) -> None:
    """Traces what a teacher does in a sweep of a task of these sizes. Raises as `rehearse_learner`."""
    source, number = f"teacher {name}: {type(teacher).__name__}", jax.ShapeDtypeStruct((), jnp.int32)
    here, teacher = _moment(obs_size, action_size, asked=True, drawn=True), _numbers(source, teacher)
    sigma = jax.ShapeDtypeStruct((), jnp.float64)
    memory = _traced(f"{source}.init", memory_of, teacher)
    _refuse_keys(f"{source}.init: memory", memory)

    def watch(teacher: Teacher, memory: Any, moment: Moment) -> Any:
        return teacher.during(moment.episode).watch(memory, moment)

    def may(teacher: Teacher, coins: Any, sigma: Any, episode: Any, step: Any) -> Any:
        return teacher.during(episode).may_advise(coins, sigma, step)

    def advise(teacher: Teacher, coins: Any, memory: Any, moment: Moment) -> Any:
        return teacher.during(moment.episode).recalling(memory).advise(coins, moment)

    if teacher.watches:
        seen = _moment(obs_size, action_size, drawn=True)
        watched = _traced(f"{source}.watch", watch, teacher, memory, seen)
        check(f"{source}.watch", "the memory", watched, memory, exactly=True)
    allowed = _traced(f"{source}.may_advise", may, teacher, here.action, sigma, number, number)
    if form(allowed) != (here.action.shape, jnp.dtype(bool)):
        wanted = f"a truth value for each action dimension, bool of shape {here.action.shape}"
        raise does_not_fit(f"{source}.may_advise", f"it gives {worded(allowed)}, it should give {wanted}")
    advice = _traced(f"{source}.advise", advise, teacher, here.action, memory, here)
    if getattr(advice, "shape", None) != here.action.shape:
        wanted = f"-1, 0 or 1 for each action dimension, an array of shape {here.action.shape}"
        raise does_not_fit(f"{source}.advise", f"it gives {worded(advice)}, it should give {wanted}")
    _refuse_unseen_sigma(source, teacher, memory, here)


def _refuse_unseen_sigma(source: str, teacher: Teacher, memory: Any, here: Moment) -> None:
    """Raises UserError: what the teacher does follows from sigma_h, of which it is shown nothing but zeros."""
    if teacher.active or teacher.is_ours:
        return
    numbers, form = eqx.partition(teacher, lambda leaf: isinstance(leaf, jax.ShapeDtypeStruct))
    recalled = lambda numbers, memory, episode: (  # noqa: E731
        eqx.combine(numbers, form).during(episode).recalling(memory)
    )

    def advise(sigma: Any, numbers: Any, memory: Any, moment: Moment, coins: Any) -> Any:
        return recalled(numbers, memory, moment.episode).advise(
            coins, dataclasses.replace(moment, sigma_human=sigma)
        )

    def chance(sigma: Any, numbers: Any, memory: Any, moment: Moment, coins: Any) -> Any:
        return recalled(numbers, memory, moment.episode).chance(sigma)

    for method in (advise, chance):
        if _follows_from_first(method, here.sigma_human, numbers, memory, here, here.action):
            raise UserError(
                f"{source}.{method.__name__} uses sigma_human, which is computed only for a class with active = True: "
                "write that line in it"
            )


def _follows_from_first(function: Callable[..., Any], *arguments: Any) -> bool:
    """Whether the numbers of the first argument, an array's shape, can change what comes of all of them."""
    jaxpr = jax.make_jaxpr(function)(*arguments).jaxpr
    used = {id(variable) for variable in jaxpr.outvars}
    for eqn in reversed(jaxpr.eqns):
        if not used.isdisjoint(map(id, eqn.outvars)):
            used.update(map(id, eqn.invars))
    return id(jaxpr.invars[0]) in used


def rehearse_task(name: str, env: Env | HostEnv) -> None:
    """Refuses a task whose physics no block of lanes can hold. Raises UserError."""
    if isinstance(env, Env):
        state = jax.eval_shape(lambda: started(env, _key()))
        _refuse_keys(f"env {name}: {type(env).__name__}.reset: its physics", state.physics)


def check_alike(cell: Cell, start: Start, template: Start) -> None:
    """Whether a run can go where the pool of `template` has its program.

    Raises:
        UserError: the learner or the teacher is of another structure, though its description says that it is not.
    """
    for word, name, one, other in (
        ("algo", cell.algo, start.learner, template.learner),
        ("teacher", cell.teacher, start.teacher, template.teacher),
    ):
        if jax.tree.structure(one) != jax.tree.structure(other):
            raise UserError(
                f'{word} {name}: what it is made of is another with each run: give its Setting compiled="value" '
                "that this follows from, and functions that are not made anew each time"
            )


def _numbers(source: str, thing: T) -> T:
    """A learner or a teacher as a program has it: what is no number is static, each number one that jax traces."""
    _refuse_keys(f"{source}: its ", thing)

    def traced(path: Any, leaf: Any) -> jax.ShapeDtypeStruct:
        kind = leaf.dtype if hasattr(leaf, "dtype") else np.asarray(leaf).dtype
        if not isinstance(kind, np.dtype) or kind.kind not in "biufcV":
            field = jax.tree_util.keystr(path).removeprefix(".")
            raise does_not_fit(source, f"its {field} is {worded(leaf)}, it should be of numbers")
        return jax.ShapeDtypeStruct(np.shape(leaf), kind)

    return jax.tree_util.tree_map_with_path(traced, fixed(thing))


def _refuse_keys(what: str, tree: Any) -> None:
    """Raises UserError: a part is a random key of jax's own type, which is no array of numbers; `what` begins it."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        if hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            place = f"{what}{jax.tree_util.keystr(path)}".replace(" .", " ")
            raise UserError(
                f"{place} is a random key: keep jax.random.key_data(key), "
                "of which jax.random.wrap_key_data makes it again"
            )


def _traced(source: str, function: Callable[..., T], *arguments: Any) -> T:
    try:
        return eqx.filter_eval_shape(function, *arguments)
    except UserError as error:
        raise UserError(f"{source}: {error}") from None
    except Exception as error:
        raise ForeignError(f"{source} fails", error) from None


def _key() -> Any:
    return seeded_key()


def _moment(obs_size: int, action_size: int, asked: bool = False, drawn: bool = False) -> Any:
    """The shapes of a step of one lane, at which its teacher is asked or only watches."""

    def made() -> Moment:
        number, action = jnp.zeros((), jnp.int32), jnp.zeros(action_size)
        told = (action, action) if asked else (None, None)
        return Moment(jnp.zeros(obs_size), action, number, number, *told, jnp.zeros(3) if drawn else None)

    return jax.eval_shape(made)
