"""Functions of a person, compiled once for each program they are, however often they are written anew.

`jax.jit` remembers a function by its identity: a new lambda is compiled again though it computes the same, and what
an old one computed is kept as long as jax likes. A function that is remembered also goes on computing with what it saw
when it was traced first: a state learned since, another value of a global name. Here a function is traced each time,
which takes a fraction of a second, and compiled only where no program of the same text was compiled before (`program`).
The arrays that it closes over and the numbers in it are arguments of that program (`lifted`), so that other values make
no new one.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Literal, Var, jaxpr_as_fun

from gpcjax.recent import recent

KEPT = 16
"""Compiled programs that are kept, those asked for last. One takes a few megabytes."""

_programs: OrderedDict[str, Callable[..., list[jax.Array]]] = OrderedDict()


def program(function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """`function` for arguments (pytrees of arrays) of these shapes and types, ready to be called many times.

    What it closes over is taken as it is now. Among values that jax traces, and with `jax.disable_jit`, nothing is
    compiled: it becomes part of the program around it.
    """
    if jax.config.jax_disable_jit:  # pyright: ignore[reportAttributeAccessIssue]
        return function
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(*arguments)
    structure, consts = jax.tree.structure(shapes), closed.consts

    def flat(consts: list[Any], leaves: list[Any]) -> list[Any]:
        return jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, consts))(*leaves)

    traced = any(isinstance(leaf, Tracer) for leaf in (*consts, *jax.tree.leaves(arguments)))
    call = flat if traced else _compiled(flat, consts, jax.tree.leaves(arguments))
    return lambda *arguments: jax.tree.unflatten(structure, call(consts, jax.tree.leaves(arguments)))


def lifted(function: Callable[..., Any], *arguments: Any) -> tuple[list[Any], Callable[..., Any], str]:
    """The values in a function of arrays, the function of these values and its arguments, and its text.

    It is traced anew at each call, also the same function: what it draws or counts is then in other values, or another
    text. Values are the arrays that it closes over and the real numbers of its outermost level, such as 0.3 in
    `lambda x: 0.3 * x`; `arguments` are arrays or their shapes.
    """
    anew = lambda *arguments: function(*arguments)  # noqa: E731  (jax knows what it has traced by its identity)
    closed, shapes = jax.make_jaxpr(anew, return_shape=True)(*arguments)
    structure, jaxpr = jax.tree.structure(shapes), closed.jaxpr
    names, numbers, eqns = [], [], []
    for eqn in jaxpr.eqns:
        invars = list(eqn.invars)
        for place, variable in enumerate(invars):
            kind: Any = variable.aval
            if isinstance(variable, Literal) and jnp.issubdtype(kind.dtype, np.floating):
                numbers.append(np.asarray(variable.val, kind.dtype))
                names.append(Var(kind))
                invars[place] = names[-1]
        eqns.append(eqn.replace(invars=invars))
    jaxpr = jaxpr.replace(constvars=[*jaxpr.constvars, *names], eqns=eqns)

    def call(values: list[Any], *arguments: Any) -> Any:
        return jax.tree.unflatten(
            structure, jaxpr_as_fun(ClosedJaxpr(jaxpr, values))(*jax.tree.leaves(arguments))
        )

    return [*closed.consts, *numbers], call, str(jaxpr)


def _compiled(flat: Callable[..., Any], *arguments: Any) -> Callable[..., list[jax.Array]]:
    # Unused arguments stay part of the text: the same text must mean the same use of the same arguments.
    lowered = jax.jit(flat, keep_unused=True).lower(*arguments)
    text = lowered.as_text()
    if (
        "callback" in text
    ):  # the text names a function of the host by a number that another one may have later
        return lowered.compile()
    key = hashlib.sha256(text.encode()).hexdigest()
    return recent(_programs, key, lowered.compile, KEPT)
