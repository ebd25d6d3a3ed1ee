# SPDX-License-Identifier: BSD-3-Clause
"""The terms of messages and reports: the glossary page of the documentation, packaged."""

import re
from functools import cache
from pathlib import Path

# A checkout has the page where the documentation is; a wheel has a copy beside this file.
PAGES = (Path(__file__).with_name("glossary.md"), Path(__file__).parents[2] / "docs" / "glossary.md")


@cache
def terms() -> dict[str, str]:
    """Each term and its definition, in the page's order."""
    page = next(path for path in PAGES if path.is_file()).read_text(encoding="utf-8")
    entries = re.findall(r"^### (.+)\n((?:(?!#).*\n?)+)", page, flags=re.MULTILINE)
    return {term: _plain(definition) for term, definition in entries}


def terms_in(text: str) -> dict[str, str]:
    """The terms that a text uses, singular or plural, with their definitions."""
    words = text.lower()
    # An option's words are no terms: --prior-pose.
    return {term: said for term, said in terms().items() if re.search(rf"(?<![\w-]){term.lower()}s?(?![\w-])", words)}


def _plain(markdown: str) -> str:
    """Text without marks, links by their words, in one paragraph."""
    words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(markdown.split()))
    return re.sub(r"[*`]", "", words)
