"""A share of a sweep's cells, for jobs that know nothing of each other: `--shard 2/8`. Loads no jax.

    OUT/shards/2-of-8/      the run folder of a share; its manifest says which one it is

Which cells a share has depends on what the folder was asked for and on nothing else: no machine, no clock, no measured
speed. Cells of one program stay together, since each job compiles for itself; the shares weigh about the same
(`gpcjax.sweep.weights`). What a folder is asked for later is shared out by itself, so that no cell changes hands.
"""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.sweep import weights
from gpcjax.sweep.growth import requests
from gpcjax.sweep.layout import MANIFEST, SHARDS
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.plan import Cell, Program, plan, program_of
from gpcjax.sweep.spec import from_dict

MOST = 100_000
"""Shares of a sweep."""

_WORD = re.compile(r"([0-9]{1,9})/([0-9]{1,9})")


class Shard(NamedTuple):
    """One of several shares, counted from 1."""

    number: int
    of: int

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    def folder(self, out: Path) -> Path:
        """Its run folder below that of the whole."""
        return out / SHARDS / f"{self.number}-of-{self.of}"

    def as_json(self) -> dict[str, int]:
        """For a manifest."""
        return self._asdict()


def shard_of(word: Any, source: str) -> Shard:
    """From `i/n`.

    Raises:
        UserError: it is none; `source` begins the message.
    """
    match = _WORD.fullmatch(word.strip()) if isinstance(word, str) else None
    if match is not None:
        number, of = int(match[1]), int(match[2])
        if 1 <= number <= of <= MOST:
            return Shard(number, of)
    raise UserError(f"{source} {shown(word)}: give i/n, the i-th of n shares, as in 1/8 to 8/8")


def held_shard(manifest: Mapping[str, Any]) -> Shard | None:
    """Which share a run folder is, None for a whole sweep's."""
    match manifest.get("shard"):
        case {"number": int(number), "of": int(of)}:
            return Shard(number, of)
    return None


def check_shard(out: Path, shard: Shard | None, cells: int) -> None:
    """Refuse a folder of another share, or of a whole sweep for a share and the other way round. Writes nothing.

    Raises:
        UserError: it is, or there are fewer cells than shares; a sweep in shards may grow by fewer.
    """
    if shard is not None and shard.of > cells and not any(out.parent.glob(f"*-of-{shard.of}/{MANIFEST}")):
        raise UserError(f"shard {shard}: there are {cells:,} cells only, give i/n with n up to that")
    try:
        held = held_shard(read_manifest(out))
    except UserError:
        return  # there is none, or it is checked and told elsewhere
    if held != shard:
        holds = "a whole sweep" if held is None else f"shard {held} of a sweep"
        asked = "no --shard" if held is None else f"--shard {held}"
        raise UserError(f"{out}: it holds {holds}, give {asked} or another --out")


def share_of(manifest: Mapping[str, Any], shard: Shard) -> list[Cell]:
    """The cells of a share: of everything that the folder was asked for, each request shared out by itself."""
    from gpcjax.sweep.rows import key_of  # which loads pyarrow

    names = tuple(manifest["varying"])
    seen: set[tuple[Any, ...]] = set()
    mine: list[Cell] = []
    for request in requests(manifest):
        keys = {key_of(cell, names): cell for cell in plan(from_dict(request["specification"]))}
        # In an order of their own: two specifications that differ in the order of their lists are one.
        new = sorted(keys.keys() - seen, key=lambda key: [*map(str, key)])
        mine += shares([keys[key] for key in new], shard.of)[shard.number - 1]
        seen |= keys.keys()
    return mine


def shares(cells: Iterable[Cell], of: int) -> list[list[Cell]]:
    """All cells in so many shares, of which the dearest costs as little as can be; none is empty while cells last.

    Each takes cells in their order, program by program, until one more would cost too much.
    """
    programs: dict[Program, list[Cell]] = {}
    for cell in cells:
        programs.setdefault(program_of(cell), []).append(cell)
    blocks = [
        _Block(
            weights.of_program(key.algo),
            weights.of_episode(key.env, key.algo, key.oracle) * key.episodes,
            mine,
        )
        for key, mine in programs.items()
    ]
    low, high = 0.0, 1.0 + sum(block.first + block.each * len(block.cells) for block in blocks)
    found = [[cell for block in blocks for cell in block.cells]]
    for _ in range(60):  # halvings: the answer is as exact as a float
        middle = (low + high) / 2
        cut = _cut(blocks, of, middle)
        if cut is None:
            low = middle
        else:
            high, found = middle, cut
    while len(found) < of:  # some would go without: the largest shares are halved for them
        largest = max(range(len(found)), key=lambda index: len(found[index]))
        half = (len(found[largest]) + 1) // 2
        found[largest : largest + 1] = [found[largest][:half], found[largest][half:]]
    return found


class _Block(NamedTuple):
    """The cells of one program: what weighs before the first, and what each weighs."""

    first: float
    each: float
    cells: list[Cell]


def _cut(blocks: Iterable[_Block], of: int, most: float) -> list[list[Cell]] | None:
    """As few shares as can be that weigh so much at most; None if they are more than `of`."""
    shares: list[list[Cell]] = [[]]
    room = most
    for block in blocks:
        left, room = block.cells, room - block.first
        while left:
            some = max(0, int(room // block.each))
            if not some and shares[-1] and len(shares) < of:
                shares.append([])
                room = most - block.first
            elif not some:
                return None
            shares[-1] += left[:some]
            left, room = left[some:], room - min(some, len(left)) * block.each
    return shares
