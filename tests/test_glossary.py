# SPDX-License-Identifier: BSD-3-Clause
import re

import pytest

from magmatch.glossary import terms, terms_in
from magmatch.registration.result import Status


def test_every_term_has_a_definition_without_marks():
    assert len(terms()) > 20
    for term, said in terms().items():
        assert len(said) > 20, term
        assert not re.search(r"[\[\]`*#]", said), term


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("evidence of 90 nats", ["Evidence", "Nat"]),
        ("6 of 8 informative cells agree", ["Cell", "Informative cell"]),
        ("signatures and nations", []),
    ],
)
def test_terms_are_found_as_words(text, found):
    assert list(terms_in(text)) == found


def test_every_status_is_a_word_of_the_page():
    from magmatch.glossary import PAGES

    page = next(path for path in PAGES if path.is_file()).read_text()
    assert all(f"`{status}`" in page for status in Status)
