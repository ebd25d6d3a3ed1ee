# SPDX-License-Identifier: BSD-3-Clause
"""Take the pictures of README.md and docs/viewing.md anew: reports, in a headless Chromium.

Run: make screenshots
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import sleep

from browser import Browser, find_browser
from magmatch.cli.main import main as magmatch
from magmatch.field.map import FieldMap
from magmatch.registration.result import RegistrationResult
from magmatch.viz.pages.registration_page import write_report

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SCENARIO, SEED = "office-overlap", "4"
FRONT, FRONT_SEED = "table", "1"
# The front page shows four figures of a report, both surveys before and after and the field of both maps, without the
# buttons that a picture does not answer to.
FRONT_FIGURES = """
    const kept = [...document.querySelectorAll('main figure')].slice(0, 4);
    document.querySelector('main').replaceChildren(...[kept.slice(0, 2), kept.slice(2)].map(pair => {
        const row = document.createElement('div');
        row.className = 'row';
        row.replaceChildren(...pair);
        return row;
    }));
    document.querySelectorAll('.modebar-container').forEach(n => n.remove());
    document.querySelectorAll('small').forEach(n => { n.textContent = n.textContent.split('; click')[0]; });
"""
# Scenes are drawn in software, which takes a moment longer than the page says.
SETTLING = 3.0
CLIPPED = "main > section:nth-of-type({})"


def main() -> None:
    path = find_browser()
    if path is None:
        sys.exit("needs Chromium")
    with TemporaryDirectory() as name, Browser(path, patience=180.0) as browser:
        folder = Path(name)
        of_the_front(browser, folder / "front")
        base, target, result = registered(folder, SCENARIO, SEED)
        write_report(folder / "r.html", base, target, result)
        on_a_desk(browser, folder / "r.html")
        on_a_phone(browser, folder / "r.html")
        of_a_map(browser, folder / "map.html")


def registered(folder: Path, scenario: str, seed: str) -> tuple[FieldMap, FieldMap, RegistrationResult]:
    """The maps of a pair, and the result."""
    folder.mkdir(exist_ok=True)
    magmatch(["simulate", scenario, "--seed", seed, "--out", str(folder / "pair")])
    for side in ("base", "target"):
        words = ["map", str(folder / "pair" / f"{side}.csv"), "--out", str(folder / f"{side}.map")]
        magmatch([*words, "--report", str(folder / "map.html")] if side == "base" else words)
    maps = [str(folder / f"{side}.map") for side in ("base", "target")]
    magmatch(["register", *maps, "--out", str(folder / "result.json")])
    loaded = [FieldMap.load(path) for path in maps]
    return loaded[0], loaded[1], RegistrationResult.load(folder / "result.json")


def of_the_front(browser: Browser, folder: Path) -> None:
    """Two surveys of a table over hidden magnets, before and after, and the field of both maps."""
    base, target, result = registered(folder, FRONT, FRONT_SEED)
    write_report(folder / "r.html", base, target, result)
    open_page(browser, folder / "r.html", 1000, 1000)
    browser.evaluate(FRONT_FIGURES)
    take(browser, "table", clip="main")


def on_a_desk(browser: Browser, page: Path) -> None:
    """The report, section by section."""
    open_page(browser, page, 1100, 1000)
    take(browser, "report", clip=None)
    for name, number in (("report-field", 3), ("report-residuals", 4), ("report-certainty", 5)):
        take(browser, name, clip=CLIPPED.format(number))


def on_a_phone(browser: Browser, page: Path) -> None:
    """The top of the report, and its cuts."""
    open_page(browser, page, 390, 844)
    take(browser, "report-phone", clip=None)
    browser.evaluate("document.querySelectorAll('h2')[1].scrollIntoView()")
    sleep(SETTLING)
    take(browser, "report-phone-field", clip=None)


def of_a_map(browser: Browser, page: Path) -> None:
    """A map's report."""
    open_page(browser, page, 1100, 1000)
    take(browser, "map-report", clip=None)


def open_page(browser: Browser, page: Path, width: int, height: int) -> None:
    browser.open(page, width, height)
    browser.wait_for("document.body.dataset.drawn")
    sleep(SETTLING)


def take(browser: Browser, name: str, clip: str | None) -> None:
    browser.screenshot(IMAGES / f"{name}.webp", clip=clip, quality=72)


if __name__ == "__main__":
    main()
