# SPDX-License-Identifier: BSD-3-Clause
"""What a page does in a real browser: it draws everything, asks for nothing, and fits a phone."""

from itertools import pairwise

import pytest

from browser import Browser, find_browser

pytest.importorskip("plotly")

from magmatch.viz.figures.draw import DARK, PAPER
from magmatch.viz.pages.map_page import write_map_report
from magmatch.viz.pages.registration_page import write_report

PATH = find_browser()
pytestmark = pytest.mark.skipif(PATH is None, reason="no Chromium installed")

N_DRAWN = "document.querySelectorAll('.plot .main-svg, .plot canvas').length"
N_PLOTS = "document.querySelectorAll('.plot').length"
UNDRAWN = (
    "[...document.querySelectorAll('.plot')].filter(p => !p.closest('details:not([open])')"
    " && !p.querySelector('.main-svg, canvas')).length"
)
THEME = "Emulation.setEmulatedMedia"
TOO_WIDE = "document.documentElement.scrollWidth - window.innerWidth"


@pytest.fixture(scope="module")
def browser():
    with Browser(PATH) as started:
        yield started


@pytest.fixture(scope="module")
def shown(browser, report):
    """The report on a desk, opened once: scenes are slow without a graphics card."""
    browser.open(report)
    browser.wait_for("document.body.dataset.drawn")
    return browser


def test_all_pictures_are_drawn_without_an_error(shown):
    assert shown.evaluate(N_PLOTS) == 13
    assert shown.evaluate(UNDRAWN) == 0
    assert shown.errors() == []
    assert shown.evaluate("document.getElementById('trouble').hidden")


def test_nothing_is_asked_of_the_network(shown, report):
    assert shown.requests() == [report.resolve().as_uri()]


def test_nothing_could_be_asked_of_the_network_if_something_tried(shown):
    tried = "fetch('https://example.org/').then(() => 'went out', () => 'refused')"
    assert shown.evaluate(tried) == "refused"


def test_no_button_sends_the_data_anywhere(shown):
    titles = shown.evaluate("[...document.querySelectorAll('.modebar-btn')].map(b => b.dataset.title)")
    assert titles
    assert not any(word in title.lower() for title in titles for word in ("cloud", "share", "edit", "studio"))


def test_arrow_keys_turn_a_scene_and_0_puts_it_back(shown):
    scene = "[...document.querySelectorAll('.plot')].find(p => p._fullLayout.scene)"
    eye = f"JSON.stringify({scene}._fullLayout.scene.camera.eye)"
    shown.evaluate(f"{scene}.focus()")
    before = shown.evaluate(eye)
    shown.press("ArrowLeft")
    shown.wait_for(f"{eye} !== '{before}'")
    shown.press("0")
    shown.wait_for(f"{eye} === '{before}'")


def test_the_command_can_be_copied(shown):
    shown.evaluate("document.querySelector('button[data-copies=command]').click()")
    shown.wait_for("document.querySelector('button[data-copies=command]').textContent !== 'Copy'")


def test_a_link_to_a_term_opens_what_the_page_says_of_it(shown):
    shown.evaluate("document.querySelector('.verdict a.term, th a.term').click()")
    shown.wait_for("document.querySelector('dl').closest('details').open")


def test_the_figures_follow_the_theme(shown):
    paper = "document.querySelector('.plot')._fullLayout.paper_bgcolor"
    body = "getComputedStyle(document.body).backgroundColor"
    assert shown.evaluate(paper) == PAPER
    before = shown.errors()
    shown.call(THEME, features=[{"name": "prefers-color-scheme", "value": "dark"}])
    shown.wait_for(f"{paper} === '{DARK[PAPER]}'")
    assert shown.evaluate(body) == "rgb" + str(tuple(bytes.fromhex(DARK[PAPER][1:])))
    shown.call(THEME, features=[{"name": "prefers-color-scheme", "value": "light"}])
    shown.wait_for(f"{paper} === '{PAPER}'")
    assert shown.errors() == before


def test_cuts_of_one_row_have_one_size_and_stand_side_by_side(shown):
    boxes = shown.evaluate(
        "[...document.querySelectorAll('.row')].find(r => r.textContent.includes('Difference of the vectors'))"
        ".querySelectorAll('.plotbg, .bglayer rect').values().map(e => e.getBoundingClientRect())"
        ".map(r => [r.y, r.width, r.height].map(Math.round)).toArray()"
    )
    assert len(boxes) == 3
    assert boxes[0] == boxes[1] == boxes[2]


def test_a_printed_page_shows_what_is_folded(shown):
    shown.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert shown.evaluate("[...document.querySelectorAll('details')].every(d => d.open)")
    shown.wait_for(f"{UNDRAWN} === 0")


def test_every_part_has_a_name_and_levels_of_headings_are_not_skipped(shown):
    nameless = (
        "[...document.querySelectorAll('.plot, nav, button')].filter(e => !(e.ariaLabel || e.textContent)).length"
    )
    assert shown.evaluate(nameless) == 0
    levels = shown.evaluate("[...document.querySelectorAll('h1, h2, h3')].map(h => +h.tagName[1])")
    assert levels[0] == 1
    assert all(b - a <= 1 for a, b in pairwise(levels))
    broken = "[...document.querySelectorAll('a')].filter(a => !document.querySelector(a.hash)).length"
    assert shown.evaluate(broken) == 0


@pytest.mark.slow
def test_a_phone_shows_it_without_scrolling_sideways(browser, report):
    browser.open(report, width=390, height=844)
    browser.wait_for("document.body.dataset.drawn")
    assert browser.evaluate(TOO_WIDE) <= 0
    assert browser.evaluate(UNDRAWN) == 0
    assert browser.errors() == []


@pytest.fixture(scope="module")
def others(pair, tmp_path_factory):
    """Pages of other kinds: a refusal, and a map."""
    folder = tmp_path_factory.mktemp("others")
    write_report(folder / "refused.html", pair.base, pair.target, pair.refused)
    write_map_report(folder / "map.html", pair.base_map, [pair.base], "magmatch map base.csv")
    return folder


@pytest.mark.parametrize("name", ["refused", pytest.param("map", marks=pytest.mark.slow)])
def test_other_pages_are_drawn_on_a_phone_too(browser, others, name):
    browser.open(others / f"{name}.html", width=390, height=844)
    browser.wait_for("document.body.dataset.drawn")
    assert browser.evaluate(TOO_WIDE) <= 0
    assert browser.evaluate(UNDRAWN) == 0
    assert browser.errors() == []
    assert len(browser.requests()) == 1
