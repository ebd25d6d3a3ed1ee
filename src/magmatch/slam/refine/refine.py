# SPDX-License-Identifier: BSD-3-Clause
"""Each window is compared once more, with one map of all earlier passes beside it, instead of with each by itself.

A map beside a single line is a guess across it; beside several it is measured. The likelihood of a log is the
product, window by window, of that of a window given all before it: so each has one such factor. Passes of one log
only: where several sensors contradict each other, a map of all shows a field that nobody measured.
"""

import logging
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import product
from magmatch.progress import counted
from magmatch.slam.graph.factors import MapFactor
from magmatch.slam.graph.solve import solve
from magmatch.slam.places import MOST_PASSES, Places
from magmatch.slam.refine.known_path import Beside, KnownPath
from magmatch.slam.refine.map_factor import map_factor
from magmatch.slam.search.candidates import Candidate
from magmatch.slam.search.comparison import Comparison, candidate, compare
from magmatch.slam.search.loop_closure import Rough
from magmatch.slam.windows import Path, Window

log = logging.getLogger(__name__)

# Windows compared at once: an interrupted run repeats no more.
AT_ONCE = 32


def refine(places: Places, paths: Sequence[Path]) -> None:
    """Find the map factors of some logs' windows, and solve with them."""
    factors: list[MapFactor] = []
    for path in paths:
        known = KnownPath.of(path, places.graph)
        windows = [window for window in path.windows if window.keeps_shape]
        runs = [windows[k : k + AT_ONCE] for k in range(0, len(windows), AT_ONCE)]
        for some in counted(f"placing {path.survey.name} on the map of its own passes", runs):
            beside = [known.beside(window, places.graph, MOST_PASSES) for window in some]
            around = [(window, one) for window, one in zip(some, beside, strict=True) if one is not None]
            for (window, one), found in zip(around, _look(places, around, known), strict=True):
                factor = map_factor(window, found[0].match, one, places.graph, path) if found else None
                factors += [factor] if factor is not None else []
    if factors:
        places.graph.map_factors = (*places.graph.map_factors, *factors)
        solve(places.graph)
    log.info("%d windows placed on maps of several passes", len(factors))


def _look(places: Places, around: Sequence[tuple[Window, Beside]], known: KnownPath) -> list[list[Candidate]]:
    """Poses of each window on the map of what is beside it, near where the graph has it."""
    graph, maker = places.graph, places.maker
    assert maker is not None

    def comparison(window: Window, beside: Beside) -> Comparison:
        T = product(graph.pose(window.node), RigidTransform.from_translation(-window.center))
        C = graph.relative_covariances(np.array([beside.nearest]), window.node)[0]
        task = maker.joint(beside.survey, beside.node, known.n_averaged)
        return Comparison(window, task, Rough(T, C), maker.noise, [], np.unique(beside.node))

    def look() -> list[list[Candidate]]:
        compared = maker.apply(compare, [comparison(*pair) for pair in around])
        return [
            [candidate(window, node, match, graph.pose(node)) for node, match in found]
            for (window, _), found in zip(around, compared, strict=True)
        ]

    return places.found_in_steps(len(around), look)
