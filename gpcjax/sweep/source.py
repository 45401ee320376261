"""What runs of a sweep begin with, as its specification and its cells name it. Loads no jax."""

from dataclasses import dataclass, field, fields
from pathlib import Path


@dataclass(frozen=True)
class Source:
    """A folder with what was learned elsewhere: the same where its content is, wherever it lies."""

    folder: str = field(compare=False)
    """Absolute: workers read it too."""
    digest: str
    """Twelve hex digits of its content, as far as runs begin with it."""

    @property
    def label(self) -> str:
        """For a person."""
        return f"{Path(self.folder).name} ({self.digest})"


FIELDS = {each.name for each in fields(Source)}
"""The keys of one as JSON has it."""
