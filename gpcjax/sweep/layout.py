"""The layout of a run folder, and how it speaks to people. Loads no jax.

    OUT/manifest.json                              what the sweep is; where, with what and how far it ran
    OUT/episodes/part-NUMBER-HASH-DIGEST.parquet   rows of finished cells
    OUT/corrections/part-...                       the corrections of the part of the same name
    OUT/kept/part-...                              what its runs had learned, where that was to be kept
    OUT/checkpoints/...                            runs that were under way, until they are finished
    OUT/shards/I-of-N/...                          run folders of shares of the sweep, see `gpcjax.sweep.shards`
    OUT/damaged/...                                what was no longer whole: set aside, never deleted
    OUT/.gpcjax.lock                               while a sweep writes here

Format 3: HASH is the specification's, DIGEST the first half of the file's SHA-256. Inside, the key-value metadata of
the Parquet file says again which specification its rows belong to, and with which versions they were made; that of the
episodes has the SHA-256 of the corrections. The manifest carries the SHA-256 of its own content. So a file tells by
itself whose it is and whether it is whole, wherever it lies and whatever became of the rest.

Format 2 had parts named `part-NUMBER-RANDOM.parquet` that say nothing of themselves, and no sums: such a folder is
read, checked as far as that goes, and continued with parts of format 3.
"""

import hashlib
import re
import sys
import warnings
from collections.abc import Callable
from typing import NamedTuple

FORMAT = 3
"""Version of the run folder's layout, kept in the manifest and in each part."""

UNSEALED = 2
"""The format whose files carry no sums."""

GROWN = 4
"""The format of a manifest that lists several requests, which earlier versions would read wrongly."""

MANIFEST = "manifest.json"
EPISODES = "episodes"
CORRECTIONS = "corrections"
KEPT = "kept"
CHECKPOINTS = "checkpoints"
DAMAGED = "damaged"
SHARDS = "shards"

BESIDE = (CORRECTIONS, KEPT)
"""Folders of files that belong to the episodes of the same name."""

Say = Callable[[str], None]
"""Takes a line for the person."""

GIVE = "give a folder that a sweep has made"
GIVE_NEW = "give a new folder, or the one of the same sweep (--out)"

_PART = re.compile(r"part-(?P<number>\d{5,})-(?P<hash>[0-9a-f]{12})-(?P<digest>[0-9a-f]{32})\.parquet")
_UNSEALED_PART = re.compile(r"part-(?P<number>\d{5,})-[0-9a-f]{12}\.parquet")

_CHECKPOINT = r"\d{10,}-\d+-\d+"


class PartName(NamedTuple):
    """What the name of a part says; `hash` and `digest` are empty in format 2."""

    number: int
    hash: str
    digest: str


def is_checkpoint(name: str) -> bool:
    """Whether a folder of this name is a whole checkpoint of ours, as far as a name can tell."""
    return re.fullmatch(_CHECKPOINT, name) is not None


def is_unfinished_checkpoint(name: str) -> bool:
    """The same of one that is being written, or that a process has left which was killed."""
    return re.fullmatch(rf"\.{_CHECKPOINT}-.*", name) is not None


def tell(line: str) -> None:
    """A line for the person at the terminal, on stderr."""
    print(f"gpcjax: {line}", file=sys.stderr, flush=True)


def warn(line: str) -> None:
    """The same for the reader of a Python call, who may turn warnings into errors."""
    warnings.warn(line, UserWarning, stacklevel=6)  # of whoever called `gpcjax.load`


def sha256(data: bytes) -> str:
    """In 64 hex digits."""
    return hashlib.sha256(data).hexdigest()


def part_name(number: int, specification: str, content: bytes) -> str:
    """The name of a part of the sweep with this hash, whose episodes are `content`."""
    return f"part-{number:05d}-{specification}-{sha256(content)[:32]}.parquet"


def parse_part(name: str) -> PartName | None:
    """What the name of a part says, None for any other file's."""
    if match := _PART.fullmatch(name):
        return PartName(int(match["number"]), match["hash"], match["digest"])
    if match := _UNSEALED_PART.fullmatch(name):
        return PartName(int(match["number"]), "", "")
    return None


def reason(error: BaseException) -> str:
    """Why, in a few words."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
