# SPDX-License-Identifier: BSD-3-Clause
"""One self-contained HTML page: words, tables and figures, with the plotting script packed inside.

Plotly's script alone is near 5 MB. It is stored compressed and unpacked by the browser (`DecompressionStream`, in all
browsers since 2023), which keeps a page at about 2 MB and still needs no network.
"""

import base64
import gzip
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from magmatch.atomic import atomic_write
from magmatch.viz.plotting import require_plotly

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def write_page(path: str | Path, title: str, sections: Sequence[str]) -> None:
    """Write a page, whole or not at all.

    Parameters
    ----------
    path : path
        Where.
    title : str
        Plain text.
    sections : sequence of str
        HTML, in order; see `figure_row`, `table` and `paragraph`.
    """
    require_plotly()
    page = Template(files("magmatch.viz").joinpath("page.html").read_text(encoding="utf-8"))
    html = page.substitute(title=escape(title), body="\n".join(sections), plotly=_packed_plotly())
    with atomic_write(path) as stream:
        stream.write(html.encode())


def figure_row(figures: "Sequence[Figure]") -> str:
    """Figures side by side, below each other where the screen is narrow."""
    return f'<div class="row">{"".join(map(_figure, figures))}</div>'


def heading(text: str) -> str:
    """Give a section a name."""
    return f"<h2>{escape(text)}</h2>"


def paragraph(text: str) -> str:
    """Plain words."""
    return f"<p>{escape(text)}</p>"


def table(rows: Sequence[Sequence[str]], header: Sequence[str] = ()) -> str:
    """Lay text out in rows; the first cell of a row names it."""
    head = "".join(f"<th scope='col'>{escape(cell)}</th>" for cell in header)
    body = "".join(
        f"<tr><th scope='row'>{escape(first)}</th>{''.join(f'<td>{escape(cell)}</td>' for cell in rest)}</tr>"
        for first, *rest in rows
    )
    head = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f"<div class='scroll'><table>{head}<tbody>{body}</tbody></table></div>"


def verdict(text: str, reason: str, *, is_good: bool) -> str:
    """The answer in words, first thing on the page."""
    mark, kind = ("&#10004;", "good") if is_good else ("&#10008;", "refused")
    return f'<div class="verdict {kind}"><strong>{mark} {escape(text)}</strong><p>{escape(reason)}</p></div>'


def details(summary: str, text: str) -> str:
    """Text that is opened on demand."""
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"


def _figure(figure: "Figure") -> str:
    """One figure with its title as caption, which wraps where a title inside the figure would not."""
    title, _, note = str(figure.layout.title.text or "").partition("<br>")
    note = note.removeprefix("<sub>").removesuffix("</sub>")
    bare = figure.to_dict()
    bare["layout"] = {**bare["layout"], "margin": {"l": 8, "r": 8, "t": 34, "b": 8}}
    bare["layout"].pop("title", None)
    from plotly.io.json import to_json_plotly

    # '<' would end the script element early where a name holds '</script>'.
    content = to_json_plotly(bare).replace("<", "\\u003c")
    caption = f"<figcaption>{title} <small>{note}</small></figcaption>"
    data = f'<script type="application/json">{content}</script>'
    return f"<figure>{caption}<div class='plot'>{data}</div></figure>"


def _packed_plotly() -> str:
    from plotly.offline import get_plotlyjs

    # Without a time stamp, so that the same result gives the same page.
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), compresslevel=9, mtime=0)).decode()
