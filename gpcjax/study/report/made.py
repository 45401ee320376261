"""Whether what was made of a study's data is of the data as they are now. Standard library only."""

import hashlib
import json
from pathlib import Path

from gpcjax.study.participant import CARD, RUNS
from gpcjax.study.register import ANALYSIS, PEOPLE, SPEC

MADE = "made.json"


def state_of(out: Path) -> str:
    """A sum that changes with what participants have done: their cards, and the names of the parts of their rows."""
    told = hashlib.sha256((out / SPEC).read_bytes() if (out / SPEC).is_file() else b"")
    for folder in sorted((out / PEOPLE).glob("p*")):
        card = folder / CARD
        if card.is_file():
            content = json.loads(card.read_bytes())
            content.pop("seen", None)  # which a page that is only open changes
            told.update(json.dumps(content, sort_keys=True).encode())
        for part in sorted(folder.glob(f"{RUNS}/*/episodes/part-*.parquet")):
            told.update(f"{part.parent.parent.name}/{part.name}".encode())
    return told.hexdigest()[:32]


def is_stale(out: Path) -> bool | None:
    """Whether the analysis in a study's folder is of other data than those that are there; None if there is none."""
    path = out / ANALYSIS / MADE
    try:
        return json.loads(path.read_bytes())["of"] != state_of(out)
    except OSError:
        return None
    except (ValueError, KeyError, TypeError):
        return True
