# SPDX-License-Identifier: BSD-3-Clause
"""The verb of this room: logs whose poses drift in, corrected and in one frame out."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from magmatch.arguments import expect_kind
from magmatch.data.checks import CONSTANT_FIELD, extent, require_survey
from magmatch.data.survey import Survey
from magmatch.registration.clock import Clock
from magmatch.registration.prepared.path_noise import MIN_BINS, PRIOR_STRETCHES, most_likely
from magmatch.slam.bases import Base, BaseMaker
from magmatch.slam.config import SlamConfig
from magmatch.slam.loop_closure import residuals
from magmatch.slam.numbers import guessed_noise, shared_numbers
from magmatch.slam.odometry import lie_level, odometry_graph
from magmatch.slam.pose_graph import PoseGraph
from magmatch.slam.sensor_bias import sensor_bias, without_bias
from magmatch.slam.session import Session
from magmatch.slam.tie import Candidate, far_candidates, near_candidates, tie
from magmatch.slam.trajectories import corrected
from magmatch.slam.windows import Path, cut
from magmatch.threads import one_blas_thread

log = logging.getLogger(__name__)

# Closures make others possible: so often at most all are looked for again.
MOST_ROUNDS = 4


def slam(logs: Survey | Sequence[Survey], config: SlamConfig | None = None) -> Session:
    """Correct the drift of logs by the magnetic field, and bring them into one frame.

    Parameters
    ----------
    logs : Survey or sequence of Survey
        Each with positions from odometry, in a frame of its own; the field in that frame.
    config : SlamConfig, optional

    Returns
    -------
    Session
        Corrected trajectories with what ties them; logs that hang on nothing stay in components of their own.

    Raises
    ------
    SurveyError
        A log holds NaN, impossible values or too few samples.
    """
    config, given = config or SlamConfig(), [logs] if isinstance(logs, Survey) else list(logs)
    expect_kind(config, "config", (SlamConfig,))
    if not given:
        msg = "expected at least one log, got none"
        raise ValueError(msg)
    for survey in given:
        require_survey(survey, name="log")
    if config.is_gravity_aligned and not config.is_planar and lie_level(given):
        log.info("all poses lie at one height: taken as planar")
        config = config.model_copy(update={"is_planar": True})
    clock = Clock()
    if all(survey.field.std(axis=0).max() < CONSTANT_FIELD for survey in given):
        return _uninformed(given, config, clock)
    with one_blas_thread():
        with clock("numbers"):
            numbers, length = shared_numbers(given)
            biases = [sensor_bias(survey, numbers) for survey in given]
        unbiased = [without_bias(survey, bias) for survey, (bias, _) in zip(given, biases, strict=True)]
        paths = cut(unbiased, length, config)
        log.info(
            "field length %.2f m; %d windows of %.1f m",
            length,
            sum(len(p.windows) for p in paths),
            config.window_length * length,
        )
        maker = BaseMaker(numbers, guessed_noise(numbers, length), length, config)
        graph = odometry_graph(paths, config)
        graph.solve()
        places = _Places(paths, graph, maker)
        with clock("noise"):
            places.learn_noise()
        with clock("closures"):
            for _ in range(MOST_ROUNDS):
                if not (places.close_near() + places.close_far()):
                    break
    return Session(given, paths, graph, config, tuple(biases), clock.seconds())


def _uninformed(given: list[Survey], config: SlamConfig, clock: Clock) -> Session:
    """Logs as they came: where the field is constant, nothing tells places apart, and it has no length."""
    paths = cut(given, max(float(extent(survey).max()) for survey in given), config)
    graph = odometry_graph(paths, config)
    graph.solve()
    return Session(given, paths, graph, config, ((np.zeros(3), np.zeros(3)),) * len(given), clock.seconds())


@dataclass(eq=False, slots=True)
class _Places:
    """Windows and the stretches they are compared with."""

    paths: list[Path]
    graph: PoseGraph
    maker: BaseMaker
    made: dict[int, Base] = field(default_factory=dict)

    def learn_noise(self) -> None:
        """Learn from the surest closures what does not repeat, and forget them: they come back."""
        self.close_near()
        windows = {w.node: w for path in self.paths for w in path.windows}
        stretches = []
        for c in self.graph.closures:
            window = windows[c.second]
            T = self.graph.center(c.first) * c.T_first_second * window.T_log_node.inv()
            stretches.append(residuals(window, self.stretch(c.first), T))
        stretches = [s for s in stretches if len(s.positions) >= MIN_BINS]
        self.graph.forget_closures()
        if len(stretches) < PRIOR_STRETCHES:
            return
        self.maker.noise = most_likely(self.maker.noise, stretches)
        log.info("noise learned from %d closures: %s", len(stretches), self.maker.noise)
        self.made.clear()

    def close_near(self) -> int:
        """Look for closures where the graph expects them; how many were found."""
        found = 0
        for path in self.paths:
            component = self.graph.component()
            mine = np.flatnonzero(component == component[path.first_node])
            closed = {c.second for c in self.graph.closures}
            candidates = [
                [] if w.node in closed else near_candidates(w, mine[mine < w.node], self.graph, self.stretch)
                for w in path.windows
            ]
            found += self._add(path, candidates)
        return found

    def close_far(self) -> int:
        """Look for closures between logs that nothing ties yet, from nowhere; how many were found."""
        found = 0
        for path in self.paths:
            component = self.graph.component()
            # Whoever came first is the base; a log that was tied since is corrected as the graph has it.
            earlier = [p for p in self.paths if p.first_node < path.first_node]
            others = [p for p in earlier if component[p.first_node] != component[path.first_node]]
            bases = [self.maker.make(corrected(p, self.graph), p.nodes[p.number]) for p in others]
            if bases:
                found += self._add(path, [far_candidates(w, bases, self.graph) for w in path.windows])
        return found

    def stretch(self, node: int) -> Base:
        """A window and its neighbours as a base, odometry's frame."""
        if node not in self.made:
            path = self.paths[self.graph.log[node]]
            rows = np.flatnonzero(np.abs(path.nodes[path.number] - node) <= 1)
            self.made[node] = self.maker.make(path.survey.subset(rows), path.nodes[path.number][rows])
        return self.made[node]

    def _add(self, path: Path, candidates: list[list[Candidate]]) -> int:
        closures = tie(path, candidates, self.graph)
        self.graph.closures += closures
        if closures:
            self.graph.solve()
        return len(closures)
