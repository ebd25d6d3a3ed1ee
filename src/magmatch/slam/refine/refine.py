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

from magmatch.data.survey import Survey
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.progress import counted
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.runner import Runner, Task
from magmatch.slam.graph.factors import SubmapFactor
from magmatch.slam.graph.solve import solve
from magmatch.slam.places import Places
from magmatch.slam.refine.submap import JointSubmap, KnownPath
from magmatch.slam.refine.submap_factor import submap_factor
from magmatch.slam.search.comparison import Candidate, Found, compare
from magmatch.slam.search.loop_closure import Expected
from magmatch.slam.search.predicted import expected_beside
from magmatch.slam.search.submaps import make_submap
from magmatch.slam.windows import Path, Window, in_runs
from magmatch.threads import single_threaded
from magmatch.typing import Indices

log = logging.getLogger(__name__)

# Windows compared at once: an interrupted run repeats no more, and as many workers have work.
AT_ONCE = 32


def refine(places: Places, paths: Sequence[Path], run: Runner) -> None:
    """Find the submap factors of some logs' windows in the order of time, then backward, and solve with them."""
    graph, found = places.graph, list[SubmapFactor]()
    of_others = graph.submap_factors
    for n_orders, later in enumerate((False, True), 1):
        for path in paths:
            found += _factors(places, path, run, later=later)
        if found:
            graph.submap_factors = (*of_others, *(replace(factor, part=1 / n_orders) for factor in found))
            solve(graph)
    log.info("windows placed on maps of several passes: %d", len(found))


def _factors(places: Places, path: Path, run: Runner, *, later: bool) -> Iterator[SubmapFactor]:
    """Factors of a log's windows with its earlier passes, or with its later ones."""
    known, graph, maker = KnownPath.of(path, places.graph), places.graph, places.maker
    assert maker is not None
    windows = [window for window in path.windows if window.keeps_shape]
    what = f"placing {path.survey.name} on the map of its own {'later' if later else 'earlier'} passes"
    for some in counted(what, in_runs(windows, AT_ONCE)):
        submaps = [known.submap(window, graph, later=later) for window in some]
        asked = [(window, submap) for window, submap in zip(some, submaps, strict=True) if submap is not None]
        tasks = [_comparison(window, submap, places, known.n_averaged) for window, submap in asked]
        for (window, submap), found in zip(asked, run(compare_with_passes, tasks), strict=True):
            if found:
                best, match = submap.best_known, found[0][1]
                candidate = Candidate.beside(best, match, window, graph.center(best))
                if (factor := submap_factor(candidate, window.node, submap, graph, path)) is not None:
                    yield factor


def _comparison(window: Window, submap: JointSubmap, places: Places, n_averaged: float) -> Task:
    """Look for a window on its submap near where the graph has it; each sample is a mean of so many."""
    maker, best = places.maker, submap.best_known
    assert maker is not None
    # They measure what lies between them, of which the submap of a single pass has its prior alone.
    numbers = replace(maker.numbers, noise_sd=maker.numbers.noise_sd / float(np.sqrt(n_averaged)))
    expected = expected_beside(window, np.array([best]), places.graph)[best]
    arguments = (window, submap.survey, submap.node, numbers, expected, maker.noise, maker.length)
    return Task(f"window {window.node} on a map of several passes", arguments)


@single_threaded
def compare_with_passes(
    window: Window, survey: Survey, node: Indices, numbers: Hyperparameters, expected: Expected, noise: PathNoise,
    length: float,
) -> Found:  # fmt: skip
    """Poses of a window near the expected one, on one map of samples of several passes."""
    return compare(window, make_submap(survey, node, numbers, noise, length, None), expected, noise, [])
