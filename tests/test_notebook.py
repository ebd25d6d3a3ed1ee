# SPDX-License-Identifier: BSD-3-Clause
"""The example notebook runs as it stands, and every noun shows a picture in it."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("ipykernel")
pytest.importorskip("plotly")

NOTEBOOK = Path(__file__).parents[1] / "examples" / "04_notebook.ipynb"
PLOTLY = "application/vnd.plotly.v1+json"


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """What each cell of code shows last, by its last line."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    folder = str(tmp_path_factory.mktemp("notebook"))
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": folder}}).execute()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return {cell.source.splitlines()[-1]: cell.outputs[-1]["data"] for cell in cells}


@pytest.mark.slow
@pytest.mark.parametrize("noun", ["base", "field_map", "result"])
def test_a_noun_shows_its_words_and_a_picture(shown, noun):
    html = shown[noun]["text/html"]
    assert html.count("<svg") == 1
    picture = ElementTree.fromstring(html[html.index("<svg") : html.index("</svg>") + 6])
    assert len(list(picture.iter())) > 1
    assert len(shown[noun]["text/plain"].splitlines()) <= 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "kind"), [("mm.view(result, field_map, target)", "scatter3d"), ("mm.view(field_map)", "heatmap")]
)
def test_a_view_is_drawn_by_the_notebook(shown, call, kind):
    assert shown[call][PLOTLY]["data"][0]["type"] == kind


@pytest.mark.slow
def test_the_registration_is_accepted(shown):
    assert "accepted" in shown["result"]["text/plain"]


def test_the_notebook_is_kept_without_what_it_prints():
    assert all(not cell.outputs for cell in nbformat.read(NOTEBOOK, as_version=4).cells if cell.cell_type == "code")
