# SPDX-License-Identifier: BSD-3-Clause
"""The method on one page: predict, search, compare, close, solve, learn; then a last look.

A log is cut into windows, the nodes of a pose graph that odometry connects. The graph predicts beside which earlier
windows each one lies; there it is compared with the field as a submap knows it. Where neighbouring windows agree, a
loop is closed, and the graph is solved before it predicts the next windows. Closures teach how far odometry drifts,
and open others, for some rounds. In the end each window is placed on one map of all passes beside it.
"""

from collections.abc import Sequence
from math import inf

from magmatch.data.survey import Survey
from magmatch.estimation.path_noise import PRIOR_STRETCHES
from magmatch.preparation.odometry.drift import FACTOR_ODDS
from magmatch.progress import counted
from magmatch.registration.clock import Clock
from magmatch.runner import Runner
from magmatch.slam.config import LEAST_KEPT, SURE, SlamConfig
from magmatch.slam.graph.anchors import Anchor
from magmatch.slam.graph.learned_drift import teaches_drift
from magmatch.slam.graph.solve import forget_closures
from magmatch.slam.loop_closer import LoopCloser
from magmatch.slam.places import Places, begin
from magmatch.slam.refine import refine
from magmatch.slam.search.loop_closure import Candidate
from magmatch.slam.vertical_offsets import with_vertical_offsets
from magmatch.slam.windows import Path
from magmatch.threads import single_threaded

# Most rounds of search, since closures make others possible; closures that noise is learned from before the search
# proper: a tenth is left to what was guessed.
MOST_ROUNDS, ENOUGH = 4, 9 * PRIOR_STRETCHES


@single_threaded
def correct(
    logs: Sequence[Survey], config: SlamConfig, anchors: Sequence[tuple[Anchor, int]], run: Runner, clock: Clock
) -> Places:
    """Correct all logs at once: noise is learned from the most certain closures, then all are searched with it."""
    with clock("numbers"):
        places = begin(logs, config, anchors)
    if places.maker is None:
        return places  # the field is constant
    closer = LoopCloser(places, run)
    with clock("noise"):
        close_near(closer, places.paths, enough=ENOUGH, least=SURE)
        closer.learn_noise()
        forget_closures(places.graph)
    with clock("closures"):
        close_all(closer, places.paths)
        if not teaches_drift(places.graph):
            # What is stated of odometry may be a guess: what a deviation more of it closes is asked, too.
            more = LoopCloser(places.drifting_more(), run)
            close_all(more, more.places.paths)
            if more.log_odds + FACTOR_ODDS[-1] > closer.log_odds + FACTOR_ODDS[0]:
                closer = more
        places = with_vertical_offsets(closer, close_all).places
    with clock("refinement"):
        refine(places, places.paths, run)
    return places


@single_threaded
def correct_more(
    earlier: Places, logs: Sequence[Survey], anchors: Sequence[tuple[Anchor, int]], run: Runner, clock: Clock
) -> Places:
    """Correct more logs with the known hyperparameters; closures between earlier logs are kept."""
    places = earlier.copied(anchors)
    closer = LoopCloser(places, run)
    with clock("closures"):
        places.solve()
        for survey in logs:
            close_all(closer, [places.add(survey)])
        places = with_vertical_offsets(closer, close_all, len(earlier.paths)).places
    with clock("refinement"):
        refine(places, places.paths[len(earlier.paths) :], run)
    return places


def close_all(closer: LoopCloser, logs: Sequence[Path]) -> None:
    """Search for closures of some logs until none is found, each time with the drift that those so far show."""
    for k in range(MOST_ROUNDS):
        if not (close_near(closer, logs, again=k > 0) + close_far(closer, logs)):
            break
        closer.learn_drift()


def close_near(
    closer: LoopCloser, logs: Sequence[Path], enough: float = inf, least: float = LEAST_KEPT, *, again: bool = False
) -> int:
    """Close loops where the graph predicts them, until there are enough; returns how many.

    A few windows at a time: what they close is known when the graph predicts those that follow. Windows long past
    were weighed by what the graph knew then, so they have no more say. Or all windows at once where logs are searched
    ``again``: the graph predicts all of them, and is solved once. ``least``: probability of a closure.
    """
    found = 0
    for path in logs:
        what = f"looking for closures of {path.survey.name}"
        n = len(path.windows) if again else path.windows[0].config.run_length
        candidates: list[list[Candidate]] = []
        for windows in counted(what, [path.windows[k : k + n] for k in range(0, len(path.windows), n)]):
            # Predict, search, compare; then what the windows agree on closes loops, with which the graph is solved.
            candidates += closer.search.near(windows, what if again else None)
            first = max(len(candidates) - 2 * n, 0)
            found += closer.close(path.only(slice(first, len(candidates))), candidates[first:], least=least)
            if found >= enough:
                return found
    return found


def close_far(closer: LoopCloser, logs: Sequence[Path]) -> int:
    """Close loops of logs with earlier ones that nothing connects them to, without a prior; returns how many."""
    found = 0
    for path in logs:
        if closer.places.others(path):
            what = f"looking for {path.survey.name} in other logs"
            found += closer.connect(path, closer.search.anywhere(path.windows, path, what))
    return found
