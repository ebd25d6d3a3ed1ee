# SPDX-License-Identifier: BSD-3-Clause
"""The page in a real browser while a log is replayed: on a desk, on a phone, in the dark."""

import threading

import pytest

from browser import Browser, find_browser
from magmatch_serve.replay import replay
from serving import client, samples, wait_until

PATH = find_browser()
pytestmark = pytest.mark.skipif(PATH is None, reason="no Chromium installed")

STATUSES = "[...document.querySelectorAll('#bodies li span')].map(n => n.textContent)"
TOO_WIDE = "document.documentElement.scrollWidth - window.innerWidth"
# Distinct colours of the map's picture: a drawn map has many.
COLOURS = """(() => { const c = document.getElementById('map'), d = c.getContext('2d')
    .getImageData(0, 0, c.width, c.height).data, seen = new Set();
    for (let k = 0; k < d.length; k += 404) seen.add(d[k] << 16 | d[k + 1] << 8 | d[k + 2]);
    return seen.size; })()"""


@pytest.fixture(scope="module")
def browser():
    with Browser(PATH) as started:
        yield started


@pytest.fixture
def walking(door, hall):
    """A log that is replayed while the test looks."""
    sender = threading.Thread(target=replay, args=(hall.walk(2, laps=1.0)[0], door.url), kwargs={"speed": 5.0})
    sender.start()
    yield
    sender.join()


@pytest.mark.parametrize(
    ("width", "height", "theme"), [(1280, 900, "light"), pytest.param(390, 844, "dark", marks=pytest.mark.slow)]
)
def test_a_walk_is_watched_from_search_to_pose(door, browser, walking, width, height, theme):
    browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": theme}])
    browser.open(door.url, width, height)
    browser.wait_for(f"{STATUSES}.some(s => s.startsWith('localized'))")
    browser.wait_for(f"{COLOURS} > 50")
    assert browser.evaluate(TOO_WIDE) <= 0
    assert browser.errors() == []
    assert {url.split("/")[2] for url in browser.requests()} == {door.url.removeprefix("http://")}
    paper = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    assert paper == ("rgb(255, 255, 255)" if theme == "light" else "rgb(20, 24, 29)")


@pytest.mark.slow
def test_bodies_are_told_before_the_map_comes_and_it_comes_once_it_can(door, browser, walking):
    browser.call("Network.setBlockedURLs", urls=["*/maps/hall.map"])
    browser.open(door.url)
    browser.wait_for(f"{STATUSES}.some(s => s.startsWith('localized'))")
    assert browser.evaluate(COLOURS) < 10
    assert door.ask("/maps/hall.map")[0] == 200
    browser.call("Network.setBlockedURLs", urls=[])
    browser.wait_for(f"{COLOURS} > 50")


@pytest.mark.slow
def test_a_window_without_room_for_the_map_is_no_error(door, browser, walking):
    browser.open(door.url)
    browser.wait_for(f"{STATUSES}.some(s => s.startsWith('localized'))")
    browser.wait_for(f"{COLOURS} > 50")
    browser.evaluate("document.getElementById('map').style.height = '20px'; draw()")
    assert browser.errors() == []


def test_a_name_is_text_and_not_markup(door, browser, hall):
    with client(door, name="<img src=x onerror=alert(1)>") as one:
        for row in list(samples(hall.walk(2)[0]))[:3]:
            one.socket.send(__import__("json").dumps(row))
            one.socket.recv(timeout=30)
        browser.open(door.url)
        browser.wait_for("document.querySelectorAll('#bodies li').length > 0")
        assert browser.evaluate("document.querySelectorAll('#bodies img').length") == 0
        assert "<img" in browser.evaluate("document.getElementById('bodies').textContent")


def test_the_page_of_paths_needs_nothing_else(door, browser):
    browser.open(f"{door.url}/docs")
    assert browser.evaluate("document.querySelectorAll('h2').length") >= 8
    assert browser.errors() == []
    wait_until(lambda: {url.split("/")[2] for url in browser.requests()} == {door.url.removeprefix("http://")})
