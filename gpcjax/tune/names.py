"""Names in comma lists: what a search may look for, what it may take. Standard library only."""

from collections.abc import Collection

from gpcjax.allowed import shown, suggestion
from gpcjax.errors import UserError

OBJECTIVES = {
    "area": "mean return of an episode",
    "final_return": "mean return of the last episodes",
    "corrections": "corrections of a run in all",
    "corrections_to_90": "median over runs of the corrections until an episode closes 90% of the gap between the idle "
    "policy and the oracle",
}


def names_of(text: str, source: str, known: Collection[str] = OBJECTIVES) -> tuple[str, ...]:
    """The names of objectives, or of what else is `known`, in a comma list. Raises UserError."""
    names = [word.strip().replace("-", "_") for word in text.split(",")]
    for name in names:
        if name not in known:
            raise UserError(f"{source} {shown(name)}: give {', '.join(known)}{suggestion(name, known)}")
        if names.count(name) > 1:
            raise UserError(f"{source} {name} is given twice: give it once")
    return tuple(names)
