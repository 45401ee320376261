"""docs/notebook.ipynb runs from its first cell to its last, and shows how far sweeps are and what came of them."""

import ast
import inspect
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import gpcjax
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of

NOTEBOOK = Path(__file__).parents[1] / "docs" / "notebook.ipynb"
SMALLER = {
    "seeds=8": "seeds=2",
    "episodes=12": "episodes=2",
    "jobs=2": 'executor=InProcess(), max_capacity=32, on_full="replace-nearest"',
}
"""With dictionaries that do not grow, in the kernel itself: there is one program of GPC, and no worker to start."""


def read():
    """The notebook, and its cells with code."""
    notebook = nbformat.read(NOTEBOOK, 4)
    return notebook, [cell for cell in notebook.cells if cell.cell_type == "code"]


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """What each cell with code shows, after a kernel has run all of them."""
    notebook, cells = read()
    for given, smaller in SMALLER.items():
        assert sum(given in cell.source for cell in cells) == 2
        for cell in cells:
            cell.source = cell.source.replace(given, smaller)
    cells[0].source = f"from gpcjax.sweep.executors import InProcess\n{cells[0].source}"
    folder = tmp_path_factory.mktemp("notebook")
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}}).execute()
    return [cell.outputs for cell in cells]


def texts(outputs, kind):
    return [output.data[kind] for output in outputs if kind in output.get("data", {})]


def test_its_cells_are_python_without_outputs_and_use_public_names():
    """Each setting that a sweep is given is one; what the kernel shows is looked at where all of it runs."""
    _, cells = read()
    assert not any(cell.outputs for cell in cells), "the notebook is kept without outputs"
    called = [
        node
        for cell in cells
        for node in ast.walk(ast.parse(cell.source))
        if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("gpcjax.")
    ]
    assert {ast.unparse(node.func) for node in called} >= {"gpcjax.run_sweep", "gpcjax.compare"}
    for node in called:
        function = getattr(gpcjax, node.func.attr)
        given = {keyword.arg: keyword.value for keyword in node.keywords}
        own = inspect.signature(function).parameters
        if node.func.attr == "run_sweep":
            settings = {name: ast.literal_eval(given[name]) for name in given if name not in own}
            assert plan(spec_of(**settings))
        else:
            assert set(given) <= set(own)


@pytest.mark.slow
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
