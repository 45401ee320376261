import errno
import functools
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.report import files
from gpcjax.report import run as run_module
from gpcjax.report.figures import curves, style
from gpcjax.report.run import draw, draw_frames
from gpcjax.sweep import runfolder
from gpcjax.sweep.reading import read_episodes
from tests.report import synthetic

PLAIN = {
    "summary.csv",
    "differences.csv",
    "curves.png",
    "curves.pdf",
    "rates.png",
    "rates.pdf",
    "report.html",
}


@pytest.fixture
def unpainted(monkeypatch):
    """Every figure is made, none is painted: that takes seconds."""
    monkeypatch.setattr(style, "image", lambda figure, kind: kind.encode())


class Reader(HTMLParser):
    """Collects text and attributes, and checks that tags are balanced."""

    def __init__(self):
        super().__init__()
        self.open, self.text, self.sources, self.tags = [], [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def read_page(out):
    reader = Reader()
    reader.feed((out / "report.html").read_text(encoding="utf-8"))
    assert not reader.open
    return reader, " ".join(reader.text)


def test_draw_writes_everything_from_the_store(out, monkeypatch):
    monkeypatch.setattr(style, "image", functools.partial(style.image, dpi=40))
    algos = ("gpc", "coach")
    frame = synthetic.episodes(seeds=3, errors=(0.0,), length=5, algos=algos)
    corrections = synthetic.corrections(seeds=3, errors=(0.0,), algos=algos)
    synthetic.write(out, frame, corrections, synthetic.manifest(frame))
    summary = draw(out)
    assert {path.name for path in summary.files} == PLAIN
    assert {path.name for path in out.iterdir()} == PLAIN | {"episodes", "corrections", "manifest.json"}
    table = pd.read_csv(out / "summary.csv")
    assert len(table) == 2 and table["final_return"].notna().all()
    before = {path: path.read_bytes() for path in summary.files}
    draw(out)
    assert before == {path: path.read_bytes() for path in summary.files}


def test_report_stands_alone_and_says_what_was_run(out, unpainted):
    frame = synthetic.episodes(seeds=3)
    frame.loc[(frame["seed"] == 1) & (frame["algo"] == "gpc") & (frame["episode"] == 30), "status"] = (
        "non-finite"
    )
    manifest = synthetic.manifest(frame, machine={"processor": "<b>fast & small</b>"})
    summary = draw_frames(out, frame, synthetic.corrections(seeds=3), manifest)
    reader, text = read_page(out)
    assert len(reader.sources) == 2 and all(
        source.startswith("data:image/svg+xml;base64,") for source in reader.sources
    )
    assert not {"script", "link", "iframe", "b"} & set(reader.tags)
    assert not re.search(r"https?://|@import|url\(", (out / "report.html").read_text())
    assert "<b>fast & small</b>" in text  # as text, not as tags
    assert "3 runs stopped (a number was not finite: 3) and count as a robot that does nothing" in text
    assert all(drawing.caption in text for drawing in (curves.learning_curves(summary),))
    assert "interquartile" not in text
    for fact in ("0123456789ab", "493,000", "0.10.0", "oracle gpc", "GPC-NS - COACH"):
        assert fact in text


def test_grid_adds_a_heatmap(out, unpainted):
    points = synthetic.length_scale_grid((0.1, 0.2), (0.1, 0.2))
    names = list(points["gpc"][0])
    frame = synthetic.episodes(seeds=3, errors=(0.0,), length=8, points=points)
    rows = synthetic.corrections(seeds=3, errors=(0.0,), points=points)
    summary = draw_frames(out, frame, rows, synthetic.manifest(frame, names))
    assert {path.name for path in summary.files} == PLAIN | {"heatmap.png", "heatmap.pdf"}
    reader, text = read_page(out)
    assert len(reader.sources) == 3 and "Every point of the grid" in text
    assert {"policy_length_scale", "human_length_scale", "best", "tied"} <= set(
        pd.read_csv(out / "summary.csv")
    )


def test_one_run_of_one_algorithm_without_corrections(out, unpainted):
    frame = synthetic.episodes(algos=("coach",), errors=(0.0,), seeds=1, length=3)
    rows = synthetic.corrections(algos=("coach",), errors=(0.0,), seeds=1).iloc[:0]
    summary = draw_frames(out, frame, rows, synthetic.manifest(frame))
    assert {path.name for path in summary.files} == PLAIN - {"rates.png", "rates.pdf"}
    assert pd.read_csv(out / "differences.csv").empty


def test_nothing_to_report(out):
    frame = synthetic.episodes(seeds=1)
    with pytest.raises(UserError, match="holds no episodes") as caught:
        draw_frames(out, frame.iloc[:0], synthetic.corrections(seeds=1), synthetic.manifest(frame))
    assert "\n" not in str(caught.value)
    assert not list(out.iterdir())


class TestUnwritable:
    """One line, as a sweep has it."""

    @pytest.fixture(autouse=True)
    def run_folder(self, out, unpainted):
        frame = synthetic.episodes(seeds=3, errors=(0.0,), length=4)
        synthetic.write(out, frame, synthetic.corrections(seeds=3, errors=(0.0,)), synthetic.manifest(frame))

    def refusal(self, out):
        with pytest.raises(UserError) as caught:
            draw(out)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    def test_a_folder_without_the_right_to_write(self, out, monkeypatch):
        def denied(**options):
            raise OSError(errno.EROFS, "Read-only file system", options["dir"])

        monkeypatch.setattr(runfolder.tempfile, "TemporaryFile", denied)
        monkeypatch.setattr(run_module, "read_counted", None)  # said before anything is read or drawn
        message = f"{out}: nothing can be written there (Read-only file system), report on a copy of it"
        assert self.refusal(out) == message

    @pytest.mark.parametrize(
        "number",
        [
            errno.ENOSPC,
            *(pytest.param(each, marks=pytest.mark.slow) for each in (errno.EDQUOT, errno.EIO, errno.EFBIG)),
        ],
    )
    def test_a_file_that_cannot_be_written(self, out, monkeypatch, number):
        def full(path, content):
            raise OSError(number, os.strerror(number), str(path))

        monkeypatch.setattr(files, "write_atomic", full)
        assert self.refusal(out) == (
            f"{out / 'summary.csv'}: cannot be written ({os.strerror(number)}), "
            "make room and give the right to write, or report on a copy"
        )

    def test_a_folder_in_the_place_of_a_file(self, out):
        (out / "report.html").mkdir()
        assert f"{out / 'report.html'}: cannot be written (Is a directory)" in self.refusal(out)

    def test_no_run_folder(self, out):
        for name in ("manifest.json", "none"):
            assert "no such folder, give a folder that a sweep has made" in self.refusal(out / name)


def test_what_is_damaged_is_left_out_with_a_line(out, unpainted, capsys):
    frame = synthetic.episodes(seeds=4, errors=(0.0,), length=4, algos=("coach",))
    corrections = synthetic.corrections(seeds=4, errors=(0.0,), algos=("coach",))
    synthetic.write(out, frame, corrections, synthetic.manifest(frame))
    for folder in ("episodes", "corrections"):
        (out / folder / "1.parquet").rename(out / folder / "part-00001-0123456789ab.parquet")
    (out / "corrections" / "part-00001-0123456789ab.parquet").write_bytes(b"")
    summary = draw(out)
    assert summary.missing == 2 and summary.study.groups[0].runs == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(
        f"gpcjax: {out}: 1 damaged part left out, the same sweep computes what is missing again"
    )


HOSTILE_FILE = "text.usetex: True\nfont.size: big\nfont.family: Papyrus\nnonsense: 3\nbackend: none\n"


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    """A report drawn here, and what a process said that drew it where the environment is hostile.

    A notebook's MPLBACKEND without its module, TeX without TeX, and a terminal that knows ASCII only.
    """
    out, settings = tmp_path_factory.mktemp("out"), tmp_path_factory.mktemp("settings")
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=2, length=4)
    rows = synthetic.corrections(algos=("gpc",), errors=(0.0,), seeds=2).iloc[:0]  # a figure is enough
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "image", functools.partial(style.image, dpi=40))
        draw_frames(out, frame, rows, synthetic.manifest(frame))
    plain = (out / "curves.png").read_bytes()
    (settings / "matplotlibrc").write_text(HOSTILE_FILE)
    frame.to_parquet(settings / "frame.parquet")
    rows.to_parquet(settings / "rows.parquet")
    code = (
        "import sys, gpcjax.report.run, gpcjax.report.terminal\n"
        "first = 'matplotlib' in sys.modules\n"  # a sweep that finds nothing missing draws nothing
        "import gpcjax.report.figures.drawing\n"
        "loaded = {'jax', 'equinox', 'brax', 'gymnasium', 'matplotlib.pyplot'} & set(sys.modules)\n"
        "print(first, loaded)\n"
        "import functools, pathlib, pandas as pd\n"
        "from rich.console import Console\n"
        "from gpcjax.report.figures import style\n"
        "from gpcjax.report.run import draw_frames\n"
        "from gpcjax.report.terminal import render\n"
        "from tests.report import synthetic\n"
        "given, out = map(pathlib.Path, sys.argv[1:])\n"
        "style.image = functools.partial(style.image, dpi=40)\n"
        "frame, rows = (pd.read_parquet(given / f'{name}.parquet') for name in ('frame', 'rows'))\n"
        "Console(width=90).print(render(draw_frames(out, frame, rows, synthetic.manifest(frame))))\n"
    )
    hostile = {
        "MPLBACKEND": "module://no_such_module.backend",
        "MATPLOTLIBRC": str(settings),
        "PYTHONIOENCODING": "ascii",
        "LC_ALL": "tr_TR.UTF-8",
    }
    done = subprocess.run(
        [sys.executable, "-c", code, str(settings), str(out)],
        capture_output=True,
        text=True,
        cwd=Path(gpcjax.__file__).parents[1],
        env={**os.environ, **hostile},
    )
    return done, plain, (out / "curves.png").read_bytes()


def test_a_report_needs_neither_jax_nor_pyplot(elsewhere):
    done, _, _ = elsewhere
    assert done.stdout.startswith("False set()\n"), done.stderr


def test_a_report_is_drawn_whatever_the_environment_says(elsewhere):
    done, plain, hostile = elsewhere
    assert done.returncode == 0, done.stderr
    assert "2500 +/- 0" in done.stdout
    assert hostile == plain


def test_what_a_learner_measures_does_not_order_its_rows(out):
    frame = synthetic.episodes(seeds=4, errors=(0.0,), length=3, algos=("coach",))
    frame["loss"] = -1.0 * frame.index  # falls: in its order the last seed would be the first
    corrections = synthetic.corrections(seeds=4, errors=(0.0,), algos=("coach",))
    synthetic.write(out, frame, corrections, synthetic.manifest(frame))
    read = read_episodes(out)
    assert read["seed"].tolist() == [0] * 3 + [1] * 3 + [2] * 3 + [3] * 3
    assert read["loss"].tolist() == frame["loss"].tolist()
