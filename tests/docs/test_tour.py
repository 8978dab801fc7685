"""docs/tour.ipynb, executed as it stands."""

import pytest
from folders import ROOT

NOTEBOOK = ROOT / "docs" / "tour.ipynb"


@pytest.mark.slow
def test_every_cell_runs_and_shows_something(tmp_path, monkeypatch):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    monkeypatch.setenv("PYTHONPATH", str(NOTEBOOK.parents[1]))
    notebook = nbformat.read(NOTEBOOK, 4)
    assert sum(cell.cell_type == "code" for cell in notebook.cells) == 10
    nbclient.NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = ["".join(str(output) for output in cell.outputs) for cell in notebook.cells if cell.cell_type == "code"]
    assert sum("image/png" in text for text in shown) == 5
    assert "million agent-steps/s" in shown[4] and "learned" in shown[7]
    assert (tmp_path / "tour-run" / "tour.rrd").is_file() and (tmp_path / "tour-run" / "tour.png").is_file()
