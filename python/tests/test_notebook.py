"""The notebook runs."""

import pathlib

import pytest

NOTEBOOK = pathlib.Path(__file__).resolve().parent.parent / "example.ipynb"
LIMIT_S = 300


def test_the_notebook_runs():
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, timeout=LIMIT_S).execute()
    text = "".join(str(cell.get("outputs")) for cell in notebook.cells)
    assert "median 0." in text and "observations" in text
