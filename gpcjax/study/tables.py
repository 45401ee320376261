"""Tables of a TOML file, read key by key: a mistake is told with its place. Standard library only."""

from collections.abc import Iterable, Mapping
from typing import Any

from gpcjax.allowed import Allowed, Anything, checked, shown, suggestion
from gpcjax.errors import UserError

TEXT = Anything("a text")
REQUIRED = object()
"""The default of a key that must be given."""

LONGEST_TEXT = 20_000


class Table:
    """One table: each key is taken once, and `done` refuses what nobody took.

    Args:
        content: what TOML has there.
        place: begins messages, as "study.toml: [runs] ".
    """

    def __init__(self, content: Any, place: str):
        if not isinstance(content, Mapping):
            raise UserError(f"{place.strip()} {shown(content)}: give a table, begun by its name in brackets")
        self._left, self.place = dict(content), place
        self._known: list[str] = []

    def __contains__(self, key: str) -> bool:
        return key in self._left

    def source(self, key: str) -> str:
        """Where a key stands, for messages."""
        return f"{self.place}{key}"

    def take(self, key: str, kind: type, allowed: Allowed = TEXT, default: Any = REQUIRED) -> Any:
        """The checked value of a key.

        Raises:
            UserError: it is missing, or not allowed.
        """
        value = self.raw(key, default)
        if value is default:
            return value
        found = checked(self.source(key), value, kind, allowed)
        if kind is str and (len(found) > LONGEST_TEXT or not found.strip()):
            raise UserError(f"{self.source(key)}: give a text of 1 to {LONGEST_TEXT:,} letters")
        return found.strip() if kind is str else found

    def several(
        self, key: str, allowed: Allowed = TEXT, default: Any = REQUIRED, least: int = 1
    ) -> tuple[str, ...]:
        """The texts of a list, or of one text; none of them twice."""
        value = self.raw(key, default)
        if value is default:
            return value
        given = [value] if isinstance(value, str) else value
        if not isinstance(given, list) or len(given) < least:
            raise UserError(f"{self.source(key)} {shown(value)}: give a list of {least} or more texts")
        found = tuple(checked(self.source(key), each, str, allowed).strip() for each in given)
        once(found, self.source(key))
        return found

    def raw(self, key: str, default: Any = REQUIRED) -> Any:
        """The value of a key as it is."""
        self._known.append(key)
        if key in self._left:
            return self._left.pop(key)
        if default is REQUIRED:
            raise UserError(f"{self.source(key)} is missing: give it")
        return default

    def table(self, key: str) -> "Table":
        """A table in this one, empty where there is none."""
        return Table(self.raw(key, {}), f"{self.place}[{key}] ")

    def tables(self, key: str) -> list["Table"]:
        """The tables of a list [[key]], none where there is none."""
        value = self.raw(key, [])
        if not isinstance(value, list):
            raise UserError(f"{self.source(key)}: begin each with a line [[{key}]]")
        return [Table(each, f"{self.place}[[{key}]] {index}: ") for index, each in enumerate(value, 1)]

    def rest(self) -> dict[str, Any]:
        """All that was not taken."""
        left, self._left = self._left, {}
        return left

    def done(self) -> None:
        """Refuses what was not taken. Raises UserError."""
        for key in self._left:
            known = ", ".join(self._known)
            raise UserError(
                f"{self.place}{shown(key)} is not known{suggestion(key, self._known)}: give {known}"
            )


def once(names: Iterable[str], source: str) -> None:
    """That no name is there twice. Raises UserError."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise UserError(f"{source}: {shown(name)} is given twice, give it once")
        seen.add(name)
