"""Lives of run folders, at random: what is asked of them, what is lost, who is killed; and what must be read then.

The rows that workers hand in are marked with a number for each run, whatever its columns say. What must be read is
what whole files hold by these numbers, each run once and with its settings.
"""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from gpcjax.errors import UserError
from gpcjax.sweep import going, merging, steady
from gpcjax.sweep import manifest as manifest_module
from gpcjax.sweep import run as run_module
from gpcjax.sweep import store as store_module
from gpcjax.sweep.blocks import block_of
from gpcjax.sweep.boxes import usual
from gpcjax.sweep.counted import read_counted
from gpcjax.sweep.growth import requests
from gpcjax.sweep.layout import BESIDE, EPISODES, MANIFEST
from gpcjax.sweep.listing import looked_into
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read, read_kept
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import from_dict, spec_of
from gpcjax.sweep.store import Store
from tests.sweep.pretended import BASELINE, Pretended, rows

BASE = {"env": "cartpole", "episodes": 2, "oracle": "lqr"}
NAMES = ("human_length_scale", "policy_length_scale", "noise")
COLUMNS = ("algo", "error", "seed", "delta", "rate", *NAMES)
ALGOS = [["gpc"], ["coach"], ["gpc-ns"], ["gpc", "coach"], ["coach", "gpc-ns"], ["gpc", "gpc-ns", "coach"]]


class Killed(BaseException):
    """A process that is no longer there."""


class Numbered(Pretended):
    """Hands in rows with the number of their run as return, as rate and as what was kept."""

    def __init__(self, numbers, fails_after=None, blocks=False):
        super().__init__(fails_after, kept=True)
        self.numbers, self.blocks, self.done = numbers, blocks, []

    def run(self, desk):
        self.varying = desk.orders.varying
        super().run(desk)

    def _work(self, cells, baselines, on_rows, on_baseline, on_progress):
        for _, name in baselines:
            on_baseline(name, BASELINE)
        several = []
        for place, cell in enumerate(cells):
            if place == self.fails_after:
                raise self.error
            several.append(self._rows(cell))
            if not self.blocks:
                on_rows(several.pop())
            elif len(several) == 3 or cell is cells[-1]:
                on_rows(block_of(several, self.varying))
                several = []

    def _rows(self, cell):
        number = self.numbers.of(cell)
        self.done.append(number)
        made = rows(cell, episodes=2, kept=True)
        made.episodes["returns"][:] = number
        made.corrections["values"][:, 0] = number
        kept = tuple(dataclasses.replace(each, returns=float(number)) for each in made.kept)
        return dataclasses.replace(made, kept=kept)


class Numbers:
    """A number for each run, by all of its settings."""

    def __init__(self):
        self._known, self.runs = {}, []

    def of(self, cell):
        given = dict(cell.hyperparameters)
        values = [
            given.get(name, usual(cell.env, cell.algo, "oracle", name))
            if name in NAMES
            else getattr(cell, name)
            for name in COLUMNS
        ]
        if (key := tuple(values)) not in self._known:
            self._known[key] = len(self.runs)
            self.runs.append(dict(zip(COLUMNS, values, strict=True)))
        return self._known[key]

    def of_all(self, specs):
        return {self.of(cell) for spec in specs for cell in plan(spec)}


class Life:
    """One run folder. `spoilt` is what damaged files hold."""

    def __init__(self, out: Path, random, monkeypatch):
        self.out, self.random, self.monkeypatch = out, random, monkeypatch
        self.numbers, self.spoilt, self.asked, self.told = Numbers(), set(), [], []
        monkeypatch.setattr(store_module, "TOGETHER", random.choice([3, 4, 16]))
        monkeypatch.setattr(going, "FLUSH_SECONDS", random.choice([-1.0, 1e9]))

    def request(self):
        """Few seeds, so that much of what is asked for is there already; and a setting that varies now and then."""
        if self.asked and self.random.random() < 0.3:
            return self.random.choice(self.asked)
        chance, choice = self.random.random, self.random.choice
        asked = {
            "algo": choice(ALGOS),
            "seeds": choice([2, 2, "1-2"]),
            "error": choice([0.1, 0.1, [0.1, 0.2]]),
        }
        if chance() < 0.15:
            asked["rate"] = choice([0.5, [0.05, 0.5]])
        if asked["algo"] != ["coach"] and chance() < 0.3:
            asked["human_length_scale"] = choice([0.3, [0.2, 0.3]])
        elif asked["algo"] == ["gpc"] and chance() < 0.2:
            asked["points"] = [
                {"policy_length_scale": 1.0, "noise": 0.1},
                {"policy_length_scale": 0.5, "noise": 0.3},
            ]
        return asked

    def ask(self, asked, shard=None, fails_after=None, kill_after=None):
        """Whether it came to its end: then it has run what was missing, and nothing else."""
        self.told.append((asked, shard, fails_after, kill_after))
        folder = self.out if shard is None else self.out / "shards" / shard.replace("/", "-of-")
        before = self.held(folder)
        executor = Numbered(self.numbers, fails_after, blocks=self.random.random() < 0.3)
        self.monkeypatch.setattr(run_module, "Processes", executor)
        try:
            with self.killed(kill_after):
                sweep(self.out, **(BASE | asked), shard=shard, keep="states")
        except (KeyboardInterrupt, Killed):
            return False
        except UserError as error:
            self.told[-1] = (asked, str(error))
            assert "in one of the two" in str(error) or "cells only" in str(error)
            return False
        wanted = self.numbers.of_all([spec_of(**(BASE | asked))])
        if shard is None:
            assert sorted(executor.done) == sorted(wanted - before)
            self.asked.append(asked)
        else:
            assert not before & set(executor.done)
        return True

    @contextlib.contextmanager
    def killed(self, count):
        """Of what is written or removed so many times happen, and nothing after them."""
        left = [1 << 30 if count is None else count]

        def counted(real):
            def once(*arguments):
                left[0] -= 1
                if left[0] < 0:
                    raise Killed
                return real(*arguments)

            return once

        with self.monkeypatch.context() as patch:
            for module in (store_module, manifest_module, merging):
                patch.setattr(module, "write_atomic", counted(module.write_atomic))
            remove = counted(Store._remove)
            patch.setattr(Store, "_remove", lambda self, names: [remove(self, [each]) for each in names])
            yield

    def lose(self, every):
        """A part, or every one; or the bytes of one of its files."""
        names = sorted(path.name for path in (self.out / EPISODES).glob("part-*"))
        damaged = not every and self.random.random() < 0.5
        self.told.append("damaged" if damaged else "all is lost" if every else "lost")
        for name in names if every else names[:1]:
            for path in (self.out / folder / name for folder in (*BESIDE, EPISODES)):
                if damaged and path.exists():
                    path.write_bytes(path.read_bytes()[:-9] + b"x" * 9)
                    self.spoilt.add(path.read_bytes())
                elif not damaged:
                    path.unlink(missing_ok=True)

    def held(self, folder):
        """The runs of whole parts, by their numbers."""
        found = set()
        for path in (folder / EPISODES).glob("part-*.parquet"):
            files = [path, *(folder / each / path.name for each in BESIDE)]
            if all(each.exists() and each.read_bytes() not in self.spoilt for each in files):
                found |= {int(each) for each in pq.read_table(path, columns=["return"])["return"].to_pylist()}
        return found

    def check(self, folder=None, known=None):
        """Everything is read, once and with its settings; also by who knows the manifest of before."""
        folder, said = folder or self.out, []
        truth, manifest = self.held(folder), read_manifest(folder)
        asked = [from_dict(each["specification"]) for each in requests(manifest)]
        every = self.numbers.of_all(asked)
        assert truth <= every
        assert "shard" in manifest or manifest["cells"] == len(every)
        for first in [None, known] if known else [None]:
            with self._known(first) if first else contextlib.nullcontext():
                try:
                    found = read(folder, said.append)
                except UserError:
                    assert not truth
                    continue
            varying = found.manifest["varying"]
            assert varying in (manifest["varying"], (first or manifest)["varying"])
            self._compare(found.episodes, "return", varying, truth, 2)
            self._compare(found.corrections, "rate", [name for name in varying if name != "rate"], truth, 2)
        self._compare(read_kept(folder, said.append), "return", manifest["varying"], truth, 1)
        if truth:
            counted, _ = read_counted(folder, said.append)
            assert counted is not None and len(counted.seeds) == len(truth)
        assert self.spoilt or not any("not rows of this sweep" in line for line in said)
        assert looked_into(folder)[1].finished == len(truth)
        return truth, every

    @contextlib.contextmanager
    def _known(self, manifest) -> Iterator[None]:
        """A reader who has this manifest, and then the one that is there."""
        first, real = [manifest], steady.read_manifest
        with self.monkeypatch.context() as patch:
            patch.setattr(steady, "read_manifest", lambda out: first.pop() if first else real(out))
            yield

    def _compare(self, frame, column, varying, truth, per):
        numbers = [int(each) for each in frame[column]] if len(frame) else []
        assert sorted(numbers) == sorted([*truth] * per)
        names = ["algo", "error", "seed", *varying]
        if numbers:
            table = pa.Table.from_pandas(frame[names], preserve_index=False)  # no value is None there
            for number, told in zip(numbers, table.to_pylist(), strict=True):
                assert told == {name: self.numbers.runs[number][name] for name in names}

    def step(self):
        """Something happens to it."""
        known = read_manifest(self.out) if (self.out / MANIFEST).exists() else None
        what = self.random.choice(["ask"] * 5 + ["fail", "kill", "lose", "lose all", "lose the manifest"])
        ended = False
        if what in ("ask", "fail", "kill") or known is None or not self.held(self.out):
            fails, kills = (self.random.randrange(12) if what == each else None for each in ("fail", "kill"))
            ended = self.ask(self.request(), fails_after=fails, kill_after=kills)
        elif what != "lose the manifest":
            self.lose(every=what == "lose all")
        elif self.asked and not self.spoilt:
            (self.out / MANIFEST).unlink()
            known = None
            ended = self.ask(self.random.choice(self.asked))
        if (self.out / MANIFEST).exists():
            truth, every = self.check(known=known)
            assert not ended or read_manifest(self.out)["complete"] == (truth == every)

    def in_shards(self):
        """Two shards are asked for the same things, the second later, perhaps by the last command alone; and merged.

        Whoever merges may be killed.
        """
        asked = [self.request() for _ in range(self.random.randrange(2, 4))]
        for each in asked:
            self.ask(each, "1/2", fails_after=self.random.choice([None, None, 1]))
        begun = (self.out / "shards/2-of-2").exists()
        for each in self.random.choice([asked, asked if begun else asked[-1:]]):
            self.ask(each, "2/2")
        for shard in ("1/2", "2/2"):
            for each in asked:
                self.ask(each, shard)
            self.check(self.out / "shards" / shard.replace("/", "-of-"))
        with contextlib.suppress(Killed), self.killed(self.random.randrange(12)):
            merging.merge([self.out])
        merging.merge([self.out])
        truth, every = self.check()
        assert truth == every
