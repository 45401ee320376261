"""The command of `tests.golden`."""

import sys
import tempfile
from pathlib import Path

from tests.golden import CASES, check, incomparable, store


def main(words: list[str]) -> int:
    """0 if all is as it is kept, 1 if something differs, 2 if nothing can be compared here."""
    match words:
        case ["check" | "store" as command, *names] if set(names) <= set(CASES):
            pass
        case _:
            print(f"give check or store, and any of {', '.join(CASES)}", file=sys.stderr)
            return 2
    different = 0
    with tempfile.TemporaryDirectory() as scratch:
        for case in names or CASES:
            if command == "store":
                store(case, Path(scratch))
                continue
            lines = list(check(case, Path(scratch)))
            if other := incomparable(Path(scratch) / case):
                print(f"{case}: nothing can be compared here, the kept rows were made with another {other}")
                return 2
            different += len(lines)
            print("\n".join(lines) or f"{case}: the same bits", flush=True)
    return int(different > 0)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
