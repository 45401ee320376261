"""Many scripted participants at once, and how it went for them. Loads no jax."""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Sequence
from urllib.parse import urlsplit

from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.study.bots.behaviour import KINDS, Kind, kind_of
from gpcjax.study.bots.place import Outcome, Place, load_page
from gpcjax.study.bots.visitor import Visitor

APART = 0.2
"""Mean seconds between one and the next: a crowd does not come in one moment."""

TELL_EVERY = 10.0


def rehearse(
    address: str,
    number: int,
    seed: int = 0,
    reading: float = 2.0,
    patience: float = 120.0,
    kinds: Sequence[Kind] = KINDS,
    say: Callable[[str], None] = lambda line: None,
) -> list[Outcome]:
    """Sends so many scripted participants through a study, and gives how it went, by their number.

    Their codes are bot-SEED-NUMBER: the same seed comes back to what it has begun.

    Args:
        address: of the study's page, as participants open it.
        number: of participants.
        seed: of all that they draw.
        reading: mean seconds for a text or a question.
        patience: seconds for which they try to come back to a server that does not answer.
        kinds: what sorts of participants there are.
        say: takes a line now and then.

    Raises:
        UserError: no study answers there.
    """
    place = Place(_checked(address))
    visitors = [
        Visitor(
            place,
            f"bot-{seed}-{each:04}",
            kind_of(each, seed, kinds),
            f"{seed}/{each}",
            reading,
            patience,
        )
        for each in range(1, number + 1)
    ]
    return asyncio.run(_all(visitors, say))


def table(outcomes: Sequence[Outcome]) -> str:
    """A line for each sort of participant and end, then who was refused or lost."""
    lines = [f"{'participants':<14} {'ended':<10} {'number':>6} {'runs':>5} {'keys':>6} {'learned':>8}"]
    counts = Counter((each.kind, each.ended) for each in outcomes)
    for (kind, ended), count in counts.items():
        own = [each for each in outcomes if (each.kind, each.ended) == (kind, ended)]
        runs, keys, learned = (
            sum(getattr(each, name) for each in own) for name in ("runs", "presses", "learned")
        )
        lines.append(f"{kind:<14} {ended:<10} {count:>6} {runs:>5} {keys:>6} {learned:>8}")
    lines += [f"{each.code}: {each.ended}: {each.text}" for each in outcomes if each.text]
    return "\n".join(lines)


def _checked(address: str) -> str:
    """An address whose page answers. Raises UserError."""
    parts = urlsplit(address)
    source = f"gpcjax study bots {shown(address)}"
    if parts.scheme not in ("http", "https") or not parts.netloc:
        raise UserError(
            f"{source}: give the participants' address that gpcjax study has printed, http://HOST:PORT/"
        )
    try:
        load_page(address, "")
    except (OSError, ValueError) as error:
        raise UserError(f"{source}: no study answers there ({error}), begin it before") from None
    return address


async def _all(visitors: Sequence[Visitor], say: Callable[[str], None]) -> list[Outcome]:
    async def late(visitor: Visitor, wait: float) -> Outcome:
        await asyncio.sleep(wait)
        return await visitor.goes()

    async def tell() -> None:
        while True:
            await asyncio.sleep(TELL_EVERY)
            done = sum(bool(each.outcome.ended) for each in visitors)
            runs = sum(each.outcome.runs for each in visitors)
            say(f"{done} of {len(visitors)} have ended, {runs:,} runs begun")

    telling = asyncio.create_task(tell())
    try:
        return await asyncio.gather(*(late(each, APART * place) for place, each in enumerate(visitors)))
    finally:
        telling.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await telling
