# SPDX-License-Identifier: BSD-3-Clause
"""Equations as MathML, made while the pages are built: browsers draw it themselves, without a script or a font."""

import html
import re

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

# What pymdownx.arithmatex leaves of $...$ and $$...$$.
EQUATION = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\(?:\(|\[)(?P<latex>.*?)\\(?:\)|\])</(?P=tag)>', re.DOTALL
)
# An operator to browsers, which part it from what it encloses.
BAR = re.compile(r'<mo(?: stretchy="false")?>&#x0007C;</mo>')


def on_page_content(content: str, **_: object) -> str:
    """Replace every equation of a page."""
    return EQUATION.sub(lambda found: mathml(html.unescape(found["latex"]), found["tag"] == "div"), content)


def mathml(latex: str, is_display: bool) -> str:
    """One equation; fails on a command that the converter does not know."""
    drawn = convert(latex.strip(), display="block" if is_display else "inline")
    if "\\" in drawn:
        msg = f"cannot draw the equation {latex!r}"
        raise PluginError(msg)
    drawn = BAR.sub('<mo stretchy="false" lspace="0" rspace="0">|</mo>', drawn)
    return f'<div class="equation">{drawn}</div>' if is_display else drawn
