"""What a torture says of its cases."""

import collections
import time
from collections.abc import Iterable


def told(what: str, judged: Iterable[tuple[str, str | None, str]]) -> int:
    """Says what became of the cases, and which were not right; how many."""
    began, counts = time.monotonic(), collections.Counter()
    for name, status, why in judged:
        counts[status or "WRONG"] += 1
        if status is None:
            print(f"{name}\n{why}", flush=True)
    kinds = ", ".join(f"{count} {status}" for status, count in counts.most_common())
    print(f"{what}: {counts.total()} in {time.monotonic() - began:.0f} s: {kinds}", flush=True)
    return counts["WRONG"]
