"""The pages that are made from the program: the data dictionary and the command line."""

import re

import pytest

import gpcjax
from docs.making import columns, flags
from gpcjax import registry
from gpcjax.allowed import FINITE
from gpcjax.cli.commands import COMMANDS
from gpcjax.errors import UserError
from gpcjax.own_settings import check_name, is_column, settings_from
from gpcjax.registry import built_in, find
from gpcjax.report.groups import gather
from gpcjax.report.summary import summarise
from gpcjax.sweep.layout import CORRECTIONS, EPISODES, KEPT
from gpcjax.sweep.plan import plan
from gpcjax.sweep.rows import tables_of
from gpcjax.sweep.spec import spec_of
from tests.report import synthetic
from tests.sweep.pretended import rows

TABLES = {EPISODES: gpcjax.load, CORRECTIONS: gpcjax.load_corrections, KEPT: gpcjax.load_policies}


def test_the_data_dictionary_has_the_columns_of_a_store():
    """Every column of the files is in the table of whatever reads them, and none that there is not."""
    cells = plan(spec_of(env="cartpole", algo=["gpc", "coach"], error=[0, 0.1], delta=[0.05, 0.1], seeds=1))
    written = tables_of([rows(cell, kept=True) for cell in cells], ["delta"])
    written[KEPT] = (
        written[KEPT].drop_columns(["kind", "card", "arrays"]).append_column("policy", [[None] * len(cells)])
    )
    for folder, read in TABLES.items():
        told = set(columns.tabled(read)) - {"...", "rate" if folder != CORRECTIONS else "advice_rate"}
        assert told == {*written[folder].column_names}, folder


def test_no_setting_and_no_measurement_of_ones_own_has_a_name_of_these():
    cells = plan(spec_of(env="cartpole", seeds=1))
    written = tables_of([rows(cell, kept=True) for cell in cells], ["rate"])
    names = {name for table in written.values() for name in table.column_names}
    for read in TABLES.values():
        names |= {*columns.tabled(read)} - {"..."}
    assert {name for name in names if not is_column(name)} == set()

    def learner(obs_size, action_size, chance=0.5):
        raise AssertionError("it is not made")

    with pytest.raises(UserError, match="algo mine:it: its argument chance is a column of every sweep, give"):
        settings_from("algo mine:it", learner, others=("obs_size", "action_size"))


def test_no_setting_of_ones_own_has_a_name_of_a_reports():
    """Where it varies it has a column there, whoever described it: the tables themselves say which names are taken."""
    frame = synthetic.episodes(errors=(0.0,), seeds=3, length=4)
    report = summarise(gather(frame, synthetic.manifest(frame)))
    for table in (report.table(), report.difference_table()):
        for name in table.columns:
            with pytest.raises(
                UserError, match=r"^it is a (setting|column) of every (sweep|report), give it another"
            ):
                check_name("it", name)
    described = gpcjax.LearnerSpec("own", make="", settings=(gpcjax.Setting("tied", "", FINITE, "it"),))
    with pytest.raises(
        UserError, match=r"^algo mine:OWN: its setting tied is a column of every report, give it"
    ):
        registry.described("learner", "mine:OWN", described)
    described = gpcjax.TeacherSpec("own", make="", settings=(gpcjax.Setting("chance", "", FINITE, "it"),))
    with pytest.raises(
        UserError, match=r"^teacher mine:OWN: its setting chance is a column of every sweep, give it"
    ):
        registry.described("teacher", "mine:OWN", described)


def test_what_learners_measure_besides_is_told():
    page = columns.page()
    for name in built_in("learner"):
        for column in find("learner", name).columns:
            assert f"| `{column.name}` | {column.type} | `{name}` | {column.text} |" in page


def test_every_flag_is_on_the_page_of_the_command_line():
    page = flags.page()
    assert re.findall(r"^## gpcjax (\S+)$", page, re.MULTILINE) == list(COMMANDS)
    for name, command in COMMANDS.items():
        part = page.partition(f"## gpcjax {name}\n")[2].partition("\n## ")[0]
        told = set(re.findall(r"`(--[\w-]+)[ `]", part))
        assert told >= {*command.names} - {"--help"}
    statuses = page.partition("## Exit status")[2]
    assert all(f"| {status} |" in statuses for status in ("0", "1", "2", "130, 143, 129", "141"))
