"""Rows of several kinds of machine in one folder: apart in their parts, and said wherever somebody looks."""

import dataclasses

import pytest

from gpcjax.report import folders, html
from gpcjax.report.content import document
from gpcjax.report.groups import gather
from gpcjax.report.summary import summarise
from gpcjax.sweep import machine
from gpcjax.sweep.listing import contents, look
from gpcjax.sweep.manifest import write_manifest
from gpcjax.sweep.opening import new_manifest
from gpcjax.sweep.origin import forget_idle_machines
from gpcjax.sweep.parts import origins_of
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.shards import Shard
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import TOGETHER, Store
from tests.cluster.test_shards import SMALL, made, stored

HERE = machine.describe()
OTHER = {**HERE, "cpu_model": "another"}
KINDS = [machine.kind_of(HERE), machine.kind_of(OTHER)]
SPEC = spec_of(env="mountaincar", algo="coach", seeds=4 * TOGETHER, episodes=1)


class TestAStore:
    @pytest.fixture
    def store(self, tmp_path):
        return Store(tmp_path, new_manifest(SPEC, [], 4 * TOGETHER), KINDS[0])

    def test_a_part_has_rows_of_one_kind(self, store, tmp_path):
        cells = plan(SPEC)
        store.append(
            [dataclasses.replace(stored(cell), machine=KINDS[1] * (cell.seed % 2)) for cell in cells[:6]]
        )
        assert sorted(origin.machine for origin in origins_of(tmp_path)) == sorted(KINDS)
        assert store.machines == set(KINDS) and store.cells == 6

    def test_and_so_has_one_that_was_put_together(self, store, tmp_path):
        for cell in plan(SPEC):
            store.append([dataclasses.replace(stored(cell), machine=KINDS[1] * (cell.seed % 2))])
        origins = origins_of(tmp_path)
        assert len(origins) == 4 and sorted(origin.machine for origin in origins) == sorted(2 * KINDS)
        again = Store(tmp_path, new_manifest(SPEC, [], 4 * TOGETHER), KINDS[0])
        assert again.missing(plan(SPEC)) == [] and again.machines == set(KINDS)


class TestAManifest:
    """Who hands out cells need not compute any: it is no machine of the rows then."""

    @pytest.mark.parametrize(
        ("with_rows", "first", "further"),
        [
            (KINDS, HERE, [OTHER]),
            (KINDS[:1], HERE, None),
            (KINDS[1:], OTHER, None),
            ([], HERE, None),
        ],
    )
    def test_it_names_the_machines_that_have_rows(self, with_rows, first, further):
        manifest = {"machine": HERE, "further_machines": [OTHER]}
        forget_idle_machines(manifest, with_rows)
        assert manifest["machine"] == first and manifest.get("further_machines") == further

    def test_an_unknown_one_stays(self):
        unknown = {"processor": "unknown"}
        manifest = {"machine": unknown, "further_machines": [OTHER]}
        forget_idle_machines(manifest, KINDS[1:])
        assert manifest == {"machine": unknown, "further_machines": [OTHER]}


@pytest.mark.parametrize("mixed", [False, True])
def test_people_are_told(mixed, tmp_path):
    folder = made(tmp_path, SMALL, Shard(1, 1))
    manifest = look(folder).manifest
    if mixed:
        write_manifest(folder, manifest := {**manifest, "further_machines": [OTHER]})
    said = folders.facts(look(folder), contents(look(folder)))
    assert said["shard"] == "1/1, for gpcjax merge"
    assert said["machine"].endswith("(2 kinds mixed: last bits may differ)") == mixed
    page = html.render(document(summarise(gather(read_episodes(folder), manifest)), []))
    assert ("Rows of 2 kinds of machine are mixed here" in page) == mixed
