"""What a report was drawn of: so that what is there already need not be drawn again."""

import hashlib
import importlib.metadata
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpcjax.report.summary import Summary
from gpcjax.sweep.layout import EPISODES, sha256

PAGE = "report.html"
_BUILT_ON = ("matplotlib", "numpy", "pandas")
_MARK = re.compile(
    r'<meta name="gpcjax-drawn" content="(?P<digest>[0-9a-f]{32})(?P<files>( [a-z.]+=[0-9a-f]{32})+)">'
)


@dataclass(frozen=True)
class Mark:
    """The digest of all that a report depends on; with those of its files it stands in the page."""

    digest: str

    @classmethod
    def made_of(cls, out: Path, manifest: Mapping[str, Any], summary: Summary) -> "Mark":
        """Of the rows in `out`, which were read and counted, and of what would draw them.

        The name of a part holds its checksum. What of the rows was not whole is not in the summary.
        """
        told = hashlib.sha256(json.dumps(manifest, sort_keys=True, default=str).encode())
        told.update(summary.table().to_csv().encode())
        told.update(" ".join(sorted(path.name for path in (out / EPISODES).glob("*.parquet"))).encode())
        told.update(" ".join(importlib.metadata.version(name) for name in _BUILT_ON).encode())
        for path in _source():
            told.update(path.read_bytes())
        return cls(told.hexdigest()[:32])

    def of(self, files: Mapping[str, bytes | str]) -> str:
        """The line for the page beside these files."""
        named = " ".join(f"{name}={_digest(written)}" for name, written in files.items())
        return f'<meta name="gpcjax-drawn" content="{self.digest} {named}">'

    def files(self, out: Path) -> tuple[Path, ...]:
        """The files of the report in `out`, if it bears this mark and all of them are as they were written; or none."""
        try:
            with open(out / PAGE, encoding="utf-8") as page:
                found = _MARK.search(page.read(4096))
            if not found or found["digest"] != self.digest:
                return ()
            named = [entry.split("=") for entry in found["files"].split()]
            if any(_digest((out / name).read_bytes()) != digest for name, digest in named):
                return ()
        except (OSError, UnicodeDecodeError):
            return ()
        return (*(out / name for name, _ in named), out / PAGE)


def _source() -> Iterable[Path]:
    """The code that counts, draws and writes, and what it is told of tasks and learners."""
    root = Path(__file__).parents[1]
    return sorted([*(root / "report").rglob("*.py"), *root.glob("*.py"), *root.glob("*/descriptions.py")])


def _digest(written: bytes | str) -> str:
    return sha256(written.encode() if isinstance(written, str) else written)[:32]
