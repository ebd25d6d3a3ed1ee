# SPDX-License-Identifier: BSD-3-Clause
"""The example notebooks run as they stand, and every noun shows a picture in the first."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("ipykernel")
pytest.importorskip("plotly")

EXAMPLES = Path(__file__).parents[1] / "examples"
PLOTLY = "application/vnd.plotly.v1+json"


def what_it_shows(name, folder):
    """What each cell of code that shows anything shows last, by its last line."""
    notebook = nbformat.read(EXAMPLES / name, as_version=4)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}}).execute()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code" and cell.outputs]
    return {cell.source.splitlines()[-1]: cell.outputs[-1].get("data", {}) for cell in cells}


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    return what_it_shows("04_notebook.ipynb", tmp_path_factory.mktemp("notebook"))


@pytest.mark.slow
@pytest.mark.parametrize("noun", ["base", "field_map", "result"])
def test_a_noun_shows_its_words_and_a_picture(shown, noun):
    html = shown[noun]["text/html"]
    assert html.count("<svg") == 1
    picture = ElementTree.fromstring(html[html.index("<svg") : html.index("</svg>") + 6])
    assert len(list(picture.iter())) > 1
    assert len(shown[noun]["text/plain"].splitlines()) <= 3
    assert noun != "result" or "accepted" in shown[noun]["text/plain"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "kind"), [("mm.view(result, field_map, target)", "scatter3d"), ("mm.view(field_map)", "heatmap")]
)
def test_a_view_is_drawn_by_the_notebook(shown, call, kind):
    assert shown[call][PLOTLY]["data"][0]["type"] == kind


@pytest.mark.slow
def test_a_descriptor_of_ones_own_is_used_and_drawn(tmp_path):
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    shown = what_it_shows("06_own_descriptor.ipynb", tmp_path)
    assert shown["own, hov"]["text/plain"].count("keypoints") == 2
    assert all(PLOTLY in shown[line] for line in shown if "_figure(" in line)
    assert len(shown) == 4


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_what_it_prints(path):
    assert all(not cell.outputs for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code")
