"""Faults that are injected into a finished run folder, by what they are called."""

import contextlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from gpcjax.sweep.layout import CORRECTIONS, EPISODES, KEPT, MANIFEST

FOLDERS = (EPISODES, CORRECTIONS, KEPT)


@dataclass
class Case:
    """A copy of a finished folder, while it is spoiled."""

    out: Path
    other: Path
    """A finished folder of another specification."""
    random: np.random.Generator
    foreign: dict[Path, bytes] = field(default_factory=dict)
    """What was laid there as somebody else's."""

    def part(self, *folders: str) -> Path:
        """A file of a part that is none of somebody else's, where there is one left."""
        folders = folders or FOLDERS
        every = sorted(path for name in folders for path in (self.out / name).glob("part-*.parquet"))
        files = [path for path in every if path.is_file() and path not in self.foreign]
        return self.pick(files) if files else self.out / MANIFEST

    def pick(self, items):
        return items[int(self.random.integers(len(items)))]

    def lay(self, name: str, content: bytes) -> None:
        path = self.out / name
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
            self.foreign[path] = content


def _edited(
    edit: Callable[[Case, bytearray], bytes | bytearray], chosen: Callable[[Case], Path]
) -> Callable[[Case], None]:
    def spoil(case: Case) -> None:
        path = chosen(case)
        if path.is_file():
            path.write_bytes(edit(case, bytearray(path.read_bytes())))

    return spoil


def _flip(case: Case, data: bytearray) -> bytearray:
    for _ in range(case.pick([1, 1, 1, 2, 9])):
        if data:
            data[int(case.random.integers(len(data)))] ^= 1 << int(case.random.integers(8))
    return data


def _cut_out(case: Case, data: bytearray) -> bytearray:
    start, end = sorted(case.random.integers(0, len(data) + 1, 2))
    del data[start:end]
    return data


def _zeros(case: Case, data: bytearray) -> bytearray:
    start, end = sorted(case.random.integers(0, len(data) + 1, 2))
    data[start:end] = bytes(end - start)
    return data


EDITS = {
    "a bit flipped": _flip,
    "cut short": lambda case, data: data[: int(case.random.integers(len(data) + 1))],
    "a piece cut out": _cut_out,
    "a piece zeroed": _zeros,
    "emptied": lambda case, data: b"",
    "something appended": lambda case, data: data + case.random.bytes(case.pick([1, 100])),
    "noise": lambda case, data: case.random.bytes(len(data)),
    "its own content twice": lambda case, data: data + data,
}


def _delete(case: Case) -> None:
    case.part().unlink(missing_ok=True)


def _delete_pair(case: Case) -> None:
    name = case.part(EPISODES).name
    for folder in FOLDERS:
        (case.out / folder / name).unlink(missing_ok=True)


def _delete_folder(case: Case) -> None:
    folder = case.out / case.pick(FOLDERS)
    shutil.rmtree(folder, ignore_errors=True)
    case.foreign = {path: content for path, content in case.foreign.items() if folder not in path.parents}


def _duplicate(case: Case) -> None:
    """Under a name that a part could have, or one that a file manager gives."""
    path = case.part()
    random = case.random.bytes(16).hex()
    names = (
        f"{path.stem} (copy).parquet",
        f"{path.name}~",
        f"{path.stem[:-32]}{random}.parquet",
        f"part-99999{path.name[10:]}",
        f"part-00000-{random[:12]}.parquet",
    )
    target = path.with_name(case.pick(names))
    if path.name != MANIFEST and not target.exists():
        shutil.copy(path, target)


def _swap(case: Case) -> None:
    one, two = case.part(), case.part()
    content = [path.read_bytes() for path in (one, two) if path.is_file()]
    if len(content) == 2:
        one.write_bytes(content[1])
        two.write_bytes(content[0])


def _swap_sides(case: Case) -> None:
    """Episodes in the place of corrections."""
    name = case.part(EPISODES).name
    one, two = case.out / EPISODES / name, case.out / CORRECTIONS / name
    if one.is_file() and two.is_file():
        content = one.read_bytes()
        one.write_bytes(two.read_bytes())
        two.write_bytes(content)


def _rename(case: Case) -> None:
    path = case.part()
    if path.name != MANIFEST and path.exists():
        path.rename(
            path.with_name(f"part-00007-{case.random.bytes(6).hex()}-{case.random.bytes(16).hex()}.parquet")
        )


def _folder_in_place(case: Case) -> None:
    path = case.part()
    if path.is_file():
        path.unlink()
        path.mkdir()


def _dangling(case: Case) -> None:
    path = case.part()
    if path.is_file():
        path.unlink()
        path.symlink_to("nowhere")


def _rewritten(case: Case) -> None:
    """Its rows read and written again, with a number changed or a row less: a valid file, but not ours."""
    path = case.part()
    if path.name == MANIFEST:
        return
    with contextlib.suppress(Exception):  # it may be spoiled already
        table = pq.read_table(path)
        pq.write_table(table.slice(0, table.num_rows - 1) if case.random.random() < 0.5 else table, path)


def _others_files(case: Case) -> None:
    folder = case.pick(["", "episodes/", "corrections/", "kept/"])
    name = case.pick(["my_data.json", ".DS_Store", "mine.parquet", "empty", "part-00000.parquet"])
    case.lay(folder + name, b"" if name == "empty" else case.random.bytes(50))


def _others_rows(case: Case) -> None:
    """Those of another specification; with its names, or with ours."""
    path = case.pick(sorted((case.other / EPISODES).glob("*.parquet")))
    for folder in FOLDERS:
        case.lay(f"{folder}/{path.name}", (case.other / folder / path.name).read_bytes())


def _others_rows_named_as_ours(case: Case) -> None:
    mine = case.part(EPISODES)
    path = case.pick(sorted((case.other / EPISODES).glob("*.parquet")))
    for folder in FOLDERS:
        target = case.out / folder / mine.name
        if target.is_file() and mine.name != MANIFEST:
            target.write_bytes((case.other / folder / path.name).read_bytes())


def _manifest_key(case: Case) -> None:
    """Without a key, or with another value."""
    path = case.out / MANIFEST
    with contextlib.suppress(Exception):  # it may be spoiled already
        content = json.loads(path.read_bytes())
        name = case.pick(sorted(content))
        if case.random.random() < 0.5:
            del content[name]
        else:
            content[name] = case.pick([None, 7, "text", [], {}, [[["deep"]]], True, 1e308])
        path.write_text(json.dumps(content))


def _manifest_of_another(case: Case) -> None:
    shutil.copy(case.other / MANIFEST, case.out / MANIFEST)


FAULTS: dict[str, Callable[[Case], None]] = {
    **{f"part: {name}": _edited(edit, lambda case: case.part()) for name, edit in EDITS.items()},
    **{f"manifest: {name}": _edited(edit, lambda case: case.out / MANIFEST) for name, edit in EDITS.items()},
    "part: deleted": _delete,
    "part: deleted, both files": _delete_pair,
    "part: its folder deleted": _delete_folder,
    "part: copied": _duplicate,
    "part: swapped with another": _swap,
    "part: its two files swapped": _swap_sides,
    "part: renamed": _rename,
    "part: a folder in its place": _folder_in_place,
    "part: a link to nowhere": _dangling,
    "part: written again": _rewritten,
    "part: another sweep's in its place": _others_rows_named_as_ours,
    "foreign: a file": _others_files,
    "foreign: rows": _others_rows,
    "manifest: a key": _manifest_key,
    "manifest: deleted": lambda case: (case.out / MANIFEST).unlink(missing_ok=True),
    "manifest: of another sweep": _manifest_of_another,
}
