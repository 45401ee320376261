"""What a search may look for, by name. Standard library only."""

from gpcjax.allowed import shown, suggestion
from gpcjax.errors import UserError

OBJECTIVES = {
    "area": "mean return of an episode",
    "final_return": "mean return of the last episodes",
    "corrections": "corrections of a run in all",
    "corrections_to_90": "median over runs of the corrections until an episode closes 90% of the gap between the idle "
    "policy and the oracle",
}


def names_of(text: str, source: str) -> tuple[str, ...]:
    """The names of objectives in a comma list. Raises UserError."""
    names = [word.strip().replace("-", "_") for word in text.split(",")]
    for name in names:
        if name not in OBJECTIVES:
            raise UserError(
                f"{source} {shown(name)}: give {', '.join(OBJECTIVES)}{suggestion(name, OBJECTIVES)}"
            )
        if names.count(name) > 1:
            raise UserError(f"{source} {name} is given twice: give it once")
    return tuple(names)
