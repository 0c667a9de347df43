"""The notebooks of the documentation run as they stand, without a network, and say what their words promise."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[2] / "docs" / "notebooks"
NAMES = sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb"))
PROMISED = {
    "bench-calibration": ["joint, 16 of 16 poses", "of tool HS-7", "U(I), k = 2, deg"],
    "own-recording": [
        "timestamp",
        "ISO 8601",
        "certain",
        "named - ",
        "base_tilt",
        "[effects.base_tilt]",
    ],
    "fleet": ["nothing_left_out", "named", "base_tilt", "HS-2: +0.4"],
}
"""what a reader must find in the outputs of each"""
WITHOUT_NETWORK = """
import socket

def _none(*_, **__):
    raise OSError("a notebook asks the network for nothing")

socket.create_connection = socket.getaddrinfo = _none
"""


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_stored_without_outputs(name: str) -> None:
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert notebook.cells[0].source.startswith("# ")
    assert not [cell for cell in code if cell.outputs or cell.execution_count]
    assert "/" not in "".join(re.findall(r'(?:open|read|Path)\("([^"]*)"', "".join(cell.source for cell in code)))


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_and_shows_what_it_says(name: str, tmp_path: Path) -> None:
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    cells.insert(0, nbformat.v4.new_code_cell(WITHOUT_NETWORK))
    notebook.cells = cells
    NotebookClient(notebook, timeout=200, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = []
    for cell in cells:
        for output in cell.outputs:
            data = output.get("data", {})
            shown.append(output.get("text") or data.get("text/html") or data.get("text/plain", ""))
    text_shown = "\n".join(text for text in shown if not text.startswith("<iframe"))
    assert [words for words in PROMISED[name] if words not in text_shown] == []
    plots = [text for text in shown if text.startswith("<iframe")]
    assert plots, "no plot"
    for plot in plots:
        assert not re.search(r"""\b(?:src|href)=(?:"|&#34;)(?!#)""", plot), "a plot asks for something beside it"


def test_each_notebook_promises_something() -> None:
    assert set(PROMISED) == set(NAMES)
