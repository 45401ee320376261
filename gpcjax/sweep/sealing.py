"""The files of a part: rows, and what they are, under a checksum. Loads no jax.

Nothing in a file is taken for rows before its sums are right: it is read into memory once, and what was checked there
is what is decoded.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from gpcjax.errors import UserError
from gpcjax.sweep.layout import BESIDE, CORRECTIONS, EPISODES, FORMAT, KEPT, parse_part, sha256
from gpcjax.sweep.plan import hash_of

_SEAL = b"gpcjax"
"""Key of the metadata in which a file says what it is, as JSON."""

_WORTH_THREADS = 1 << 20
"""Bytes from which threads decode faster than they start."""


GROUP = 1 << 22
"""Bytes of what is kept that are read at once."""


class Origin(NamedTuple):
    """What rows come from beside their cell: kept in each part."""

    hash: str
    """Of the specification."""
    versions: Mapping[str, str]
    machine: str
    """`gpcjax.sweep.machine.kind_of` the machine that computed them."""
    asked: Sequence[Mapping[str, Any]] = ()
    """Specifications that had been asked of the folder by then, as JSON has them: its own, and those that no part named
    before. Parts of 0.2 have all of them, and nothing of what follows."""
    named: Sequence[str] = ()
    """Their hashes."""
    order: Sequence[str] = ()
    """The hashes of all that had been asked for by then, the first one first."""
    manifest: Mapping[str, Any] = MappingProxyType({})
    """Entries of the manifest that nothing else could tell of."""

    @property
    def before(self) -> Sequence[str]:
        """The hashes of what had been asked for by then, of parts of 0.2 too."""
        return self.order or self.named or [hash_of(each) for each in self.asked]


class Opened(NamedTuple):
    """The episodes of a part, whose sum is right."""

    origin: Origin
    sums: Mapping[str, str]
    """SHA-256 of the files of the same name, by their folder."""
    replaces: tuple[str, ...]
    """Names of the parts whose rows were put together here."""
    data: bytes


class Damage(Exception):
    """What is wrong with a file, and in which folder it lies."""

    def __init__(self, folder: str, what: str):
        super().__init__(what)
        self.folder = folder


def sealed(
    table: pa.Table,
    kind: str,
    origin: Origin,
    sums: Mapping[str, str] | None = None,
    replaces: Sequence[str] = (),
) -> bytes:
    """The file of a part: rows, and what they are. `kind` is the folder that it goes to."""
    told = origin._asdict() | {"manifest": dict(origin.manifest)}
    if kind != EPISODES:  # these tell what their part is, the others no more than whose they are
        told = {name: told[name] for name in ("hash", "versions", "machine")}
    seal: dict[str, Any] = {"format": FORMAT, "table": kind, **told, **(sums or {})}
    if replaces:
        seal["replaces"] = list(replaces)
    sink = pa.BufferOutputStream()
    schema = {**(table.schema.metadata or {}), _SEAL: json.dumps(seal)}
    # Factors of matrices are half zeros: zstd finds that.
    compression = "zstd" if kind == KEPT else "snappy"
    pq.write_table(
        table.replace_schema_metadata(schema),
        sink,
        write_page_checksum=True,
        compression=compression,
        # Of what is kept a reader wants a row here and there.
        row_group_size=max(1, GROUP * len(table) // max(1, table.nbytes)) if kind == KEPT else None,
    )
    return sink.getvalue().to_pybytes()


def opened(out: Path, name: str) -> Opened | None:
    """The episodes of a part, and what they say that they are; None if they say something else than its name.

    Raises:
        Damage: they are not what was written.
        UserError: they cannot be read, whatever they hold.
    """
    part = parse_part(name)
    if part is None or not part.hash:
        return None
    data = bytes_of(out, EPISODES, name)
    if sha256(data)[: len(part.digest)] != part.digest:
        raise Damage(EPISODES, "its checksum differs")
    match seal_of(data):
        case {
            "format": version,
            "table": table,
            "hash": told,
            "versions": dict(),
            "corrections": str(),
        } as seal:
            if (version, table, told) == (FORMAT, EPISODES, part.hash):
                asked = [each for each in seal.get("asked") or () if isinstance(each, dict)]
                named, order = (list(map(str, seal.get(name) or ())) for name in ("named", "order"))
                more = seal.get("manifest") or {}
                origin = Origin(
                    part.hash, seal["versions"], str(seal.get("machine", "")), asked, named, order, more
                )
                sums = {folder: seal[folder] for folder in BESIDE if isinstance(seal.get(folder), str)}
                return Opened(origin, sums, tuple(seal.get("replaces", ())), data)
    return None  # whole, and not written by this version


def beside(out: Path, folder: str, name: str, opened: Opened) -> bytes:
    """The file of a part in another folder, whose episodes were opened. Raises `Damage` if it is not that one."""
    data = bytes_of(out, folder, name)
    if sha256(data) != opened.sums[folder]:
        raise Damage(folder, "its checksum differs")
    return data


def replaced_by(out: Path, name: str) -> tuple[str, ...]:
    """Names of parts that this one says to hold the rows of, as far as can be told without reading all of it."""
    try:
        seal = json.loads((pq.read_metadata(out / EPISODES / name).metadata or {}).get(_SEAL, b"{}"))
        return tuple(map(str, seal.get("replaces", ())))
    except (
        Exception
    ):  # whatever Parquet's readers make of bytes that are none of theirs: found to be damaged later
        return ()


def columns_of(out: Path, name: str) -> list[str]:
    """Names of the columns of a part's episodes, as far as can be told without reading them."""
    try:
        return list(pq.read_schema(out / EPISODES / name).names)
    except Exception:  # as above
        return []


def bytes_of(out: Path, folder: str, name: str) -> bytes:
    """A file of a part. Raises `Damage`, and `UserError` if it may not be read."""
    try:
        return (out / folder / name).read_bytes()
    except PermissionError as error:
        raise UserError(f"{error.filename}: cannot be read ({error.strerror})") from None
    except OSError as error:
        raise Damage(folder, f"it cannot be read, {error.strerror}") from None


def seal_of(data: bytes) -> dict[str, Any] | None:
    """What a file says it is, None if it says nothing. Raises `Damage`."""
    try:
        seal = (pq.read_schema(pa.BufferReader(data)).metadata or {}).get(_SEAL)
        told = None if seal is None else json.loads(seal)
    except Exception as error:  # as above
        raise Damage(CORRECTIONS, f"it is no Parquet file, {_brief(error)}") from None
    return told if isinstance(told, dict) else None


def decoded(data: bytes, columns: Sequence[str] | None = None, folder: str = EPISODES) -> pa.Table:
    """The rows of a file; of `columns` those that it has. Raises `Damage`."""
    threads = len(data) > _WORTH_THREADS
    try:
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        there = file.schema_arrow.names
        chosen = None if columns is None else [name for name in columns if name in there]
        table = file.read(chosen, use_threads=threads)
        table.validate(full=True)
    except Exception as error:  # as above
        raise Damage(folder, f"it cannot be decoded, {_brief(error)}") from None
    return table.replace_schema_metadata(None)


def _brief(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:100]
