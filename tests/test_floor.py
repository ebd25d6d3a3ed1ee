# SPDX-License-Identifier: BSD-3-Clause
"""The page of a floor from phone logs, run as it stands."""

import re

import pytest

from run_tutorial import PAGES, run_page

PAGE = next(page for page in PAGES if page.name == "floor.md")


@pytest.mark.slow
def test_the_page_of_a_floor_says_what_its_commands_print(tmp_path):
    pytest.importorskip("vqf", reason="extra odometry")
    text = PAGE.read_text()
    now = run_page(text, tmp_path)
    # Digits may differ between machines; what is found and what is refused may not.
    assert re.sub(r"\d+(\.\d+)?", "#", now) == re.sub(r"\d+(\.\d+)?", "#", text)
    assert (tmp_path / "floor" / "map.map").is_file()
    assert "Never localized" in now
