"""Whether what the learners of a sweep learn can be kept. Loads no jax for those that are built in."""

import dataclasses

from gpcjax.registry import built_in
from gpcjax.sweep.keeping import Keeping
from gpcjax.sweep.plan import plan
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import SweepSpec


def check_keeping(keeping: Keeping | None, spec: SweepSpec, source: str = "keep") -> None:
    """Refuses to keep what has no form in which it could be kept, before anything is computed.

    Raises:
        UserError: a learner of a person's own has a part that is no array of numbers, or cannot be made.
    """
    others = [name for name in spec.algo if name not in built_in("learner")]
    if keeping is None or not others:
        return
    from gpcjax.learners.recipes import check_recipe
    from gpcjax.sweep.build import recipe_of

    for name in others:
        one_seed = dataclasses.replace(spec, algo=(name,), seeds=Seeds(((0, 0),)))
        check_recipe(recipe_of(plan(one_seed)[0]), source)
