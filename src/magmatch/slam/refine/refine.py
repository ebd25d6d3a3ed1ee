# SPDX-License-Identifier: BSD-3-Clause
"""Each window is compared once more, with one map of all passes beside it, instead of with each by itself.

A map beside a single line is a guess across it; beside several it is measured. The likelihood of a log is the
product, window by window, of that of a window given all before it, or given all after it: the mean of both is taken.
Passes of one log only: where several sensors contradict each other, a map of all shows a field that nobody measured.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from magmatch.progress import counted
from magmatch.slam.graph.factors import SubmapFactor
from magmatch.slam.graph.solve import solve
from magmatch.slam.places import Places, in_runs
from magmatch.slam.refine.submap import KnownPath, Submap
from magmatch.slam.refine.submap_factor import submap_factor
from magmatch.slam.search.candidates import Candidate
from magmatch.slam.search.comparison import Comparison, candidate, compare
from magmatch.slam.search.predicted import expected_beside
from magmatch.slam.windows import Path, Window

log = logging.getLogger(__name__)

# Windows compared at once: an interrupted run repeats no more, and as many workers have work.
AT_ONCE = 32


def refine(places: Places, paths: Sequence[Path]) -> None:
    """Find the submap factors of some logs' windows in the order of time, then backward, and solve with them."""
    graph, found = places.graph, list[SubmapFactor]()
    of_others = graph.submap_factors
    for n_orders, later in enumerate((False, True), 1):
        for path in paths:
            found += _factors(places, path, later=later)
        if found:
            graph.submap_factors = (*of_others, *(replace(factor, part=1 / n_orders) for factor in found))
            solve(graph)
    log.info("windows placed on maps of several passes: %d", len(found))


def _factors(places: Places, path: Path, *, later: bool) -> Iterator[SubmapFactor]:
    """Factors of a log's windows with its earlier passes, or with its later ones."""
    known = KnownPath.of(path, places.graph)
    windows = [window for window in path.windows if window.keeps_shape]
    what = f"placing {path.survey.name} on the map of its own {'later' if later else 'earlier'} passes"
    for some in counted(what, in_runs(windows, AT_ONCE)):
        submaps = [known.submap(window, places.graph, later=later) for window in some]
        asked = [(window, submap) for window, submap in zip(some, submaps, strict=True) if submap is not None]
        for (window, submap), found in zip(asked, _look(places, asked, known), strict=True):
            factor = submap_factor(found[0], window.node, submap, places.graph, path) if found else None
            if factor is not None:
                yield factor


def _look(places: Places, asked: Sequence[tuple[Window, Submap]], known: KnownPath) -> list[list[Candidate]]:
    """The pose of each window on its submap, near where the graph has it, if there is one."""
    graph, maker = places.graph, places.maker
    assert maker is not None

    def comparison(window: Window, submap: Submap) -> Comparison:
        expected = expected_beside(window, np.array([submap.best_known]), graph)[submap.best_known]
        task = maker.joint(submap.survey, submap.node, known.n_averaged)
        return Comparison(window, task, expected, maker.noise, [])

    def look() -> list[list[Candidate]]:
        compared = maker.apply(compare, [comparison(*pair) for pair in asked])
        return [
            [candidate(window, s.best_known, match, graph.center(s.best_known)) for _, match in found]
            for (window, s), found in zip(asked, compared, strict=True)
        ]

    return places.found_in_steps(len(asked), look)
