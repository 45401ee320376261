"""docs/notebook.ipynb runs from its first cell to its last, and shows how far sweeps are and what came of them."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).parents[1] / "docs" / "notebook.ipynb"
SMALLER = {"seeds=8": "seeds=2", "episodes=12": "episodes=2"}


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """The cells with code by their first line, after a kernel has run all of them."""
    notebook = nbformat.read(NOTEBOOK, 4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs for cell in cells), "the notebook is kept without outputs"
    for given, smaller in SMALLER.items():
        assert sum(given in cell.source for cell in cells) == 2
        for cell in cells:
            cell.source = cell.source.replace(given, smaller)
    folder = tmp_path_factory.mktemp("notebook")
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}}).execute()
    return [cell.outputs for cell in cells]


def texts(outputs, kind):
    return [output.data[kind] for output in outputs if kind in output.get("data", {})]


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_it_runs_and_shows_itself(executed):
    (told,) = texts(executed[1], "text/plain")
    assert told.startswith("cartpole: 8/8 cells in ") and "compiling" not in told
    (report,) = texts(executed[2], "text/html")
    assert "Cartpole, oracle gpc" in report and report.count("data:image/png;base64,") == 2
    (plain,) = texts(executed[2], "text/plain")
    assert plain == "<report on cartpole: 4 groups, 8 runs, runs/notebook>"
    (comparison,) = texts(executed[5][-1:], "text/html")
    assert "What differs" in comparison and "data:image/svg+xml;base64," in comparison
    assert texts(executed[6], "text/plain")[0].startswith("array([")
