# SPDX-License-Identifier: BSD-3-Clause
"""One self-contained HTML page: text, tables and figures, with the plotting script included.

Plotly's script alone is near 5 MB. It is stored compressed and unpacked by the browser (`DecompressionStream`, in all
browsers since 2023), which keeps a page at about 2 MB and still needs no network.
"""

import base64
import gzip
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, TypeVar

import yaml

from magmatch.atomic import write_whole
from magmatch.glossary import terms
from magmatch.viz.figures.draw import DARK, Figure, require_plotly

T = TypeVar("T")
# Most closures, anchors or parts of a log that are listed one by one.
MAX_LISTED = 40
# Height over width of what a scene shows.
SCENE_SHAPE = 0.78


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page."""

    title: str  # plain text; empty for what stands first and needs none
    blocks: Sequence[str]  # HTML, in order; see `figure_row`, `table` and `paragraph`

    def anchor(self, k: int) -> str:
        """Name to link to, of the k-th section: titles may repeat."""
        return f"s{k}-" + re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


def write_page(path: str | Path, title: str, sections: Sequence[Section]) -> None:
    """Write a page atomically; sections with a title are listed at the top, terms explained at the end."""
    require_plotly()
    sections = [*sections, *_terms_of(sections)]
    page = Template(files("magmatch.viz.pages").joinpath("page.html").read_text(encoding="utf-8"))
    html = page.substitute(
        title=escape(title),
        contents=_contents(sections),
        body="\n".join(_section(section, k) for k, section in enumerate(sections)),
        dark=json.dumps(DARK),
        plotly=_packed_plotly(),
    )
    write_whole(path, html.encode())


def figure_row(figures: Sequence[Figure]) -> str:
    """Figures side by side, below each other where the screen is narrow."""
    return f'<div class="row">{"".join(map(_figure, figures))}</div>'


def columns(*parts: Sequence[str]) -> str:
    """Blocks in columns, below each other where the screen is narrow."""
    inner = "".join(f"<div>{''.join(blocks)}</div>" for blocks in parts)
    return f'<div class="columns">{inner}</div>'


def subheading(text: str) -> str:
    """Give a part of a section a name."""
    return f"<h3>{escape(text)}</h3>"


def paragraph(text: str) -> str:
    """Plain words."""
    return f"<p>{escape(text)}</p>"


def with_terms(text: str) -> str:
    """Plain words, in which terms of the glossary link to what the page says of them."""
    named = "|".join(re.escape(term) for term in sorted(terms(), key=len, reverse=True))
    linked = lambda found: f'<a class="term" href="#{_anchor(found[1])}">{found[0]}</a>'  # noqa: E731
    return re.sub(rf"\b({named})s?\b", linked, escape(text), flags=re.IGNORECASE)


def note(text: str) -> str:
    """Plain words in passing."""
    return f'<p class="note">{escape(text)}</p>'


def bullets(items: Sequence[str]) -> str:
    """Plain words, one thing after the other."""
    return f"<ul>{''.join(f'<li>{escape(item)}</li>' for item in items)}</ul>"


def table(rows: Sequence[Sequence[str]], header: Sequence[str] = (), *, named: Callable[[str], str] = escape) -> str:
    """Lay text out in rows; the first cell of a row names it, in HTML that `named` gives."""
    head = "".join(f"<th scope='col'>{escape(cell)}</th>" for cell in header)
    body = "".join(
        f"<tr><th scope='row'>{named(first)}</th>{''.join(f'<td>{escape(cell)}</td>' for cell in rest)}</tr>"
        for first, *rest in rows
    )
    head = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f"<div class='scroll'><table>{head}<tbody>{body}</tbody></table></div>"


def listing(things: Iterable[T], columns: Mapping[str, Callable[[T], str]]) -> str:
    """Lay out things in rows and what is said of each in columns, by their headers; the first column names them."""
    return table([[said(thing) for said in columns.values()] for thing in things], list(columns))


def answer(words: str, steps: Sequence[str], *more: str) -> Section:
    """The section that stands first: the verdict, what to do next, and further blocks."""
    return Section("", [words, "<h2 id='next'>What to do next</h2>", bullets(steps), *more])


def verdict(text: str, reason: str, answer: str = "", *, is_good: bool) -> str:
    """The answer in words, first thing on the page."""
    mark, kind = ("&#10004;", "good") if is_good else ("&#10008;", "refused")
    words = f"<strong><span aria-hidden='true'>{mark}</span> {escape(text)}</strong>"
    told = f"<p class='answer'>{escape(answer)}</p>" if answer else ""
    return f'<div class="verdict {kind}">{words}{told}<p>{with_terms(reason)}</p></div>'


def to_copy(name: str, text: str, *, is_wrapped: bool = False) -> str:
    """Text with a button that copies it; `name` is its own on the page."""
    button = f'<button type="button" data-copies="{name}">Copy</button>'
    return f'{button}<pre id="{name}" tabindex="0"{" class=wrapped" if is_wrapped else ""}>{escape(text)}</pre>'


def details(summary: str, html: str, *, is_open: bool = False) -> str:
    """Fold what is opened on demand."""
    return f"<details{' open' if is_open else ''}><summary>{escape(summary)}</summary>{html}</details>"


def again(title: str, words: str, command: str | None, settings: Mapping[str, Any], *more: str) -> Section:
    """Section on how to get the same once more: words, the command, further blocks, and the settings, folded."""
    text = yaml.safe_dump(settings, sort_keys=False, width=100)
    blocks = [paragraph(words)] if words else []
    blocks += [] if command is None else [to_copy("command", command, is_wrapped=True)]
    return Section(title, [*blocks, *more, details("settings.yaml", to_copy("settings", text))])


def _terms_of(sections: Sequence[Section]) -> list[Section]:
    """Fold the terms that the sections link to, with their meanings."""
    text = "".join(block for section in sections for block in section.blocks)
    used = {term: said for term, said in terms().items() if f'href="#{_anchor(term)}"' in text}
    told = "".join(
        f'<dt id="{_anchor(term)}">{escape(term)}</dt><dd>{escape(said)}</dd>' for term, said in used.items()
    )
    return [Section("Terms", [details("Glossary", f"<dl>{told}</dl>")])] if used else []


def _anchor(term: str) -> str:
    return "term-" + re.sub(r"[^a-z0-9]+", "-", term.lower())


def _contents(sections: Sequence[Section]) -> str:
    """Links to the sections that have a title, where there are enough to need them."""
    links = [f'<li><a href="#{s.anchor(k)}">{escape(s.title)}</a></li>' for k, s in enumerate(sections) if s.title]
    return f'<nav aria-label="Contents"><ul>{"".join(links)}</ul></nav>' if len(links) > 2 else ""


def _section(section: Section, k: int) -> str:
    body = "\n".join(section.blocks)
    if not section.title:
        return f"<section>{body}</section>"
    name = section.anchor(k)
    return f'<section aria-labelledby="{name}"><h2 id="{name}">{escape(section.title)}</h2>{body}</section>'


def _figure(figure: Figure) -> str:
    """One figure with its title as caption, which wraps where a title inside the figure would not."""
    from plotly.io.json import to_json_plotly

    title, _, small = str(figure.layout.title.text or "").partition("<br>")
    small = small.removeprefix("<sub>").removesuffix("</sub>")
    bare = figure.to_dict()
    bare["layout"] = {**bare["layout"], "margin": {"l": 8, "r": 8, "t": 30, "b": 8}}
    bare["layout"].pop("title", None)
    bare["layout"]["legend"] = {**bare["layout"].get("legend", {}), "y": 1.0, "yanchor": "top"}
    meta = bare["layout"].pop("meta", None) or {}
    is_scene = "scene" in bare["layout"]
    keys = " Arrow keys turn it, plus and minus zoom, 0 shows it as it was." if is_scene else ""
    alt, shape = meta.get("alt", title), SCENE_SHAPE if is_scene else meta.get("shape")
    if any(trace.get("visible") == "legendonly" for trace in bare["data"]):
        small += "; click a grey name to show what is hidden"
    # '<' would end the script element early where a name holds '</script>'.
    content = to_json_plotly(bare).replace("<", "\\u003c")
    caption = f"<figcaption>{title} <small>{small}</small></figcaption>"
    place = f'class="plot" tabindex="0" role="img" style="height:{bare["layout"].get("height", 400)}px"'
    place += f' data-shape="{shape:.4g}"' if shape else ""
    data = f'<script type="application/json">{content}</script>'
    return f'<figure>{caption}<div {place} aria-label="{escape(alt + keys)}">{data}</div></figure>'


@cache
def _packed_plotly() -> str:
    """The plotting script, compressed; half a second's work that several pages share."""
    from plotly.offline import get_plotlyjs

    # Without a time stamp, so that the same result gives the same page.
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), compresslevel=9, mtime=0)).decode()
