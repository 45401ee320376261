"""Faults injected into finished run folders: is each one found, and everything as before after the same sweep again?

    python -m tests.torture [--cases 1000] [--kills 200] [--seed 0]

The rows are pretended (no jax), the store is the real one. Each case takes a finished folder, spoils it in one to three
ways, reads it, and runs its sweep again. Right is: the rows that are read are rows of the sweep, each once; the same
sweep ends with all of them, as they were, or refuses in one line; what lay there of somebody else stays as it is. A
folder of format 2 has no checksums: of it only what can be known is asked, that no fault ends in a traceback. Then real
sweeps are killed at random moments (`tests.kills`).
"""

import argparse
import collections
import contextlib
import io
import json
import os
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from gpcjax.errors import UserError
from gpcjax.sweep import going
from gpcjax.sweep import run as run_module
from gpcjax.sweep.layout import CORRECTIONS, EPISODES, KEPT, MANIFEST
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.reading import Rows, read, read_kept
from gpcjax.sweep.run import run
from gpcjax.sweep.sources import contents_of
from gpcjax.sweep.spec import spec_of
from tests import kills
from tests.sweep.pretended import Pretended

SETTINGS = {"env": "cartpole", "episodes": 3, "oracle": "lqr", "error": 0.1, "delta": [0.0, 0.05]}
FIRST = spec_of(algo=["gpc", "coach"], seeds=1, **SETTINGS)
SPEC = spec_of(algo=["gpc", "coach"], seeds=2, **SETTINGS)
OTHER = spec_of(algo="gpc", seeds=3, sparsify=False, **SETTINGS)
FOLDERS = (EPISODES, CORRECTIONS, KEPT)
KEYS = ["algo", "oracle", "error", "delta", "seed"]
LASTING = ("hash", "specification", "varying", "cells", "baselines", "versions", "machine", "complete")
"""What a manifest says, however often the sweep went on."""


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
        """A file of a part, where there is one left."""
        folders = folders or FOLDERS
        files = sorted(
            path for name in folders for path in (self.out / name).glob("part-*.parquet") if path.is_file()
        )
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


def finished(out: Path, spec=SPEC, first=None) -> Path:
    """A whole sweep, a part for each cell; of a folder that grew, if it was asked for `first` before."""
    out.mkdir()
    with _workers(), mock.patch.object(going, "FLUSH_SECONDS", -1.0):
        for each in filter(None, (first, spec)):
            run(each, out, 1)
    return out


def unsealed(out: Path, source: Path) -> Path:
    """The same folder in format 2."""
    for folder in (EPISODES, CORRECTIONS):
        (out / folder).mkdir(parents=True)
        for number, path in enumerate(sorted((source / folder).glob("*.parquet"))):
            table = pq.read_table(path).replace_schema_metadata(None)
            pq.write_table(table, out / folder / f"part-{number:05d}-{number:012x}.parquet")
    manifest = read_manifest(source) | {"format": 2}
    del manifest["sha256"]
    (out / MANIFEST).write_text(json.dumps(manifest, indent=2))
    return out


def judge(case: Case, reference: Rows, learned: pd.DataFrame, sealed: bool) -> str:
    """What became of a spoiled folder, in a word.

    Raises:
        AssertionError: it was not right.
    """
    lines: list[str] = []
    _assert_begins_with_some_of(case.out, learned)
    try:
        got = read(case.out, lines.append)
    except UserError as error:
        lines.append(str(error))
    else:
        if sealed:
            _assert_some_of(got, reference)
    printed, status = io.StringIO(), "as it was"
    try:
        with _workers() as pretended, contextlib.redirect_stderr(printed):
            run(SPEC, case.out, 1)
        status = "computed again" if pretended.calls else status
    except UserError as error:
        lines.append(str(error))
        status = "refused"
    told = printed.getvalue()
    lines += [line for line in told.splitlines() if line.startswith("gpcjax: ")]
    assert all(lines) and "\n" not in "".join(lines), lines
    assert "Traceback" not in told and len(lines) <= 8, told
    for path, content in case.foreign.items():
        assert path.read_bytes() == content, f"{path} is another's, and was changed"
    if status != "refused" and sealed:
        later: list[str] = []
        again = read(case.out, later.append)
        assert not [line for line in later if "damaged" in line or "twice" in line], later
        _assert_same(again.episodes, reference.episodes)
        _assert_same(again.corrections, reference.corrections)
        _assert_same(read_kept(case.out, later.append), learned)
        for name in LASTING:
            assert again.manifest[name] == reference.manifest[name], name
    return status


def torture(cases: int, seed: int, sealed: bool = True) -> Iterator[tuple[str, str | None, str]]:
    """The names of the faults of each case, what became of it (None: it was not right), and why."""
    with tempfile.TemporaryDirectory() as folder:
        whole = finished(Path(folder, "whole"), first=FIRST if sealed else None)
        other = finished(Path(folder, "other"), OTHER)
        if not sealed:
            whole = unsealed(Path(folder, "unsealed"), whole)
        reference, learned = read(whole), read_kept(whole)
        names = list(FAULTS)
        for number in range(cases):
            random = np.random.default_rng([seed, number])
            case = Case(Path(folder, "case"), other, random)
            shutil.copytree(whole, case.out)
            # Every fault alone first, then some at once.
            chosen = [names[number % len(names)]]
            if number >= len(names):
                chosen += [names[i] for i in random.integers(0, len(names), random.integers(3))]
            try:
                for name in chosen:
                    FAULTS[name](case)
                yield f"{number}: {'; '.join(chosen)}", judge(case, reference, learned, sealed), ""
            except Exception:
                yield f"{number}: {'; '.join(chosen)}", None, traceback.format_exc()
            shutil.rmtree(case.out)


@contextlib.contextmanager
def _workers() -> Iterator[Pretended]:
    pretended = Pretended(kept=True)
    with (
        mock.patch.object(run_module, "Processes", pretended),
        contextlib.redirect_stderr(io.StringIO() if not isinstance(sys.stderr, io.StringIO) else sys.stderr),
    ):
        yield pretended


def _assert_same(got: pd.DataFrame, expected: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(got, expected, check_exact=True)


def _assert_some_of(got: Rows, reference: Rows) -> None:
    """Whole runs of the sweep, each once, with the rows that they have."""
    if not len(got.episodes):
        return
    cells = got.episodes[KEYS].drop_duplicates()
    for frame, expected in ((got.episodes, reference.episodes), (got.corrections, reference.corrections)):
        some = expected.merge(cells, on=KEYS, how="inner")[list(expected.columns)]
        order = [*KEYS, "episode", *(["step"] if "step" in frame else [])]
        # Without runs of COACH a column has no nulls, and keeps its integers.
        pd.testing.assert_frame_equal(
            frame.sort_values(order, ignore_index=True),
            some.sort_values(order, ignore_index=True),
            check_exact=True,
            check_dtype=False,
        )


def _checkpoints(cases: int, seed: int) -> int:
    """Those of a sweep that was killed in the middle of its runs, spoiled as often; how many were not right."""
    from tests import torture_underway  # which takes faults from here
    from tests.sweep.test_underway import COMPILED, KEEP, killed_under_way

    with tempfile.TemporaryDirectory() as folder:
        out, began = killed_under_way(Path(folder), COMPILED | KEEP), time.monotonic()
        judged = list(torture_underway.torture(out, cases, seed))
    for name, status, why in judged:
        if status is None:
            print(f"{name}\n{why}")
    what = ", ".join(
        f"{count} {status or 'WRONG'}"
        for status, count in collections.Counter(status for _, status, _ in judged).most_common()
    )
    print(f"checkpoints: {cases} times spoiled in {time.monotonic() - began:.0f} s: {what}")
    return sum(status is None for _, status, _ in judged)


def _assert_begins_with_some_of(out: Path, learned: pd.DataFrame) -> None:
    """What a sweep would begin with (`--start`) is what was kept of that run, or nothing of the folder is taken."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            contents = contents_of(out, "start")
            taken = [(state, contents.packed(state)) for state in contents.states]
        except UserError as error:
            assert "\n" not in str(error)
            return
    assert not any("\n" in str(each.message) for each in said)
    columns = [*KEYS, "card", "arrays"]
    kept = {tuple(row[:-2]): tuple(row[-2:]) for row in learned[columns].itertuples(index=False)}
    for state, packed in taken:
        assert kept[tuple(state.values[name] for name in KEYS)] == packed


def main() -> int:
    """Says how many cases became what, and prints those that were not right."""
    parser = argparse.ArgumentParser(
        description="Spoil run folders and kill sweeps, and see that nothing is lost."
    )
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    wrong = 0
    for sealed in (True, False):
        began, counts = time.monotonic(), collections.Counter()
        for name, status, why in torture(arguments.cases, arguments.seed, sealed):
            counts[status or "WRONG"] += 1
            if status is None:
                wrong += 1
                print(f"{name}\n{why}")
        what = ", ".join(f"{count} {status}" for status, count in counts.most_common())
        form = "format 3" if sealed else "format 2, without checksums"
        print(f"{form}: {arguments.cases} spoiled folders in {time.monotonic() - began:.0f} s: {what}")
    wrong += _checkpoints(arguments.cases, arguments.seed)
    killed = list(kills.torture(arguments.kills, arguments.seed))
    print("\n".join(killed) if killed else "no kill did any harm")
    return os.EX_OK if not wrong and not killed else 1


if __name__ == "__main__":
    sys.exit(main())
