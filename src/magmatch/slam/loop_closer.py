# SPDX-License-Identifier: BSD-3-Clause
"""The closing of loops: candidates that are believed become closures, which teach noise and drift."""

import logging
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logit

from magmatch.estimation.path_noise import PRIOR_STRETCHES, most_likely
from magmatch.estimation.walk import MIN_BINS
from magmatch.runner import Runner
from magmatch.slam.config import LEAST_KEPT, SURE
from magmatch.slam.decide import log_odds_shared, probable_closures
from magmatch.slam.graph.factors import Closure
from magmatch.slam.graph.learned_drift import learned_drift
from magmatch.slam.graph.solve import solve, surprise_before
from magmatch.slam.loop_search import LoopSearch
from magmatch.slam.places import Places
from magmatch.slam.search.loop_closure import Candidate
from magmatch.slam.windows import Path, Window
from magmatch.typing import Indices

log = logging.getLogger(__name__)

# So sure must be what teaches noise, and that logs share a frame.
SURE_ODDS = float(logit(SURE))
# A submap itself states this of the noise: closures' poses were fitted to the same residuals, mostly near its path.
MAPS_OWN = ("map_factor", "map_length")


class LoopCloser:
    """Adds closures to a graph, and solves with them; a runner does the comparisons."""

    def __init__(self, places: Places, run: Runner) -> None:
        self.places, self.search = places, LoopSearch(places, run)

    def close(
        self, path: Path, candidates: list[list[Candidate]], but: Collection[int] = (), least: float = LEAST_KEPT
    ) -> int:
        """Add closures of a log's windows, one a pass, except of some, and solve; returns how many were found.

        They are more probable than ``least``.
        """
        graph = self.places.graph
        closures = [
            replace(c, paid=surprise_before(graph, c))
            for c in probable_closures(path, candidates, graph, self.places.paths, least)
            if c.second not in but and not graph.has_closure(np.array([c.first]), c.second).any()
        ]
        # Of these the graph does not know which submap the window lies on.
        half = path.windows[0].path_length / 2
        lost = [c for c in closures if graph.sds_of_place(np.array([c.first]), c.second)[0] > half]
        closures = [c for c in closures if c not in lost]
        graph.closures = [*graph.closures, *closures]
        if closures:
            solve(graph)
        if lost:
            # Windows that may lie anywhere: all of them must say so.
            nodes = self.places.known_to(path.windows[0])
            lost = [] if self.confirm(path, candidates, lost, nodes, path.windows) is None else lost
        return len(closures) + len(lost)

    def connect(self, path: Path, candidates: list[list[Candidate]], whole: Path | None = None) -> int:
        """Add the probable closures with other components, if all of the log's windows say that the frame is shared.

        The candidates are of a whole log's windows, or of its last ones. Returns how many closures were found.
        """
        whole, component, found = whole or path, self.places.graph.component(), 0
        proposed = probable_closures(path, candidates, self.places.graph, self.places.paths)
        for one in sorted({int(component[c.first]) for c in proposed}):
            closures = [c for c in proposed if component[c.first] == one]
            nodes = np.flatnonzero(component == one)
            near = self.confirm(path, candidates, closures, nodes, whole.windows)
            if near is not None:
                found += len(closures) + self.close(whole, near, {c.second for c in self.places.graph.closures})
        return found

    def confirm(
        self,
        path: Path,
        candidates: list[list[Candidate]],
        closures: list[Closure],
        nodes: Indices,
        windows: Sequence[Window],
    ) -> list[list[Candidate]] | None:
        """Add closures that candidates of a path propose from nowhere with some nodes, if windows say so.

        Gives where these then lie, None if they do not.
        """
        places, before, log_prior = self.places, self.places.graph, dict[int, float]()
        for c in closures:
            proposed = candidates[c.second - path.first_node]
            log_prior[c.second] = next(k.match.log_prior for k in proposed if k.node == c.first)
        places.graph = graph = before.copied()
        graph.closures = [*graph.closures, *closures]
        solve(graph)
        near = self.search.at(windows, [nodes] * len(windows))
        odds = log_odds_shared(windows, places.points_of(nodes), near, log_prior, graph)
        log.info("windows %d to %d on known path: log odds %.1f", windows[0].node, windows[-1].node, odds)
        if odds >= SURE_ODDS:
            return near
        places.graph = before
        return None

    def learn_noise(self) -> None:
        """Learn the noise that does not repeat from closures, and where the graph alone says what is passed again."""
        stretches = [s for s in self.search.repeats() if len(s.positions) >= MIN_BINS]
        if len(stretches) < PRIOR_STRETCHES:
            return
        noise = most_likely(self.search.maker.noise, stretches, MAPS_OWN)
        self.places.maker = replace(self.search.maker, noise=noise)
        self.search.weigh_anew()
        log.info("noise learned from %d closures: %s", len(stretches), noise)

    def learn_drift(self) -> None:
        """Learn how far odometry drifts from how well its closures agree with it, and solve with that.

        A closure that few others spoke for when it was found is believed again, with those found since.
        """
        places = self.places
        places.graph.weigh_closures(np.ones(len(places.graph.closures)))
        places.solve()
        config = learned_drift(places.graph, places.paths, places.stated)
        log.info("odometry drifts by %.2g m and %.2g deg in 10 m", *config.odometry.sd)
        places.take_drift(config)
        self.search.weigh_anew()

    @property
    def log_odds(self) -> float:
        """Log odds of the closures that the graph keeps, over that nothing was passed twice, nats."""
        closures = self.places.graph.as_arrays
        return float(closures.odds[closures.is_kept].sum())
