# SPDX-License-Identifier: BSD-3-Clause
"""The method on one page: hyperparameters that logs share, windows, and rounds of search for loop closures."""

import logging
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logit

from magmatch.data.checks import extent
from magmatch.data.diagnoses import CONSTANT_FIELD
from magmatch.data.survey import Survey
from magmatch.progress import counted, tell
from magmatch.registration.clock import Clock
from magmatch.registration.decide.decision import DecisionConfig
from magmatch.registration.prepared.path_noise import PRIOR_STRETCHES, Stretch, most_likely
from magmatch.registration.prepared.walk import MIN_BINS
from magmatch.slam.bases import Base, BaseMaker
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor, fixed_points
from magmatch.slam.graph.learned_drift import learned_drift
from magmatch.slam.graph.odometry import follow, lie_level, odometry_graph
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.solve import forget_closures, solve
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.loop_closure import SAME_SHIFT, residuals
from magmatch.slam.numbers import guessed_noise, shared_numbers
from magmatch.slam.sensor_bias import sensor_bias, without_bias
from magmatch.slam.shared_frame import log_odds_shared
from magmatch.slam.steps import Steps
from magmatch.slam.tie import (
    Candidate,
    Searched,
    far_candidates,
    near_candidates,
    nearby,
    numbers_of,
    of_numbers,
    tie,
)
from magmatch.slam.windows import Path, Window, cut
from magmatch.threads import one_blas_thread
from magmatch.typing import Indices, Vector3

log = logging.getLogger(__name__)

# Closures make others possible: maximum number of rounds of search.
MOST_ROUNDS = 4
# Log odds from which logs share a frame: those of the probability that a registration needs.
SURE_ODDS = float(logit(DecisionConfig().min_probability))
# Closures that noise and drift are learned from before the search proper: a tenth is left to what was guessed.
ENOUGH = 9 * PRIOR_STRETCHES
# Stretches kept in memory as bases, at about 10 MB each.
MOST_BASES = 128
NO_BIAS = (np.zeros(3), np.zeros(3))


@dataclass(eq=False, slots=True)
class Places:
    """Windows of logs, their graph, and the stretches that they are compared with."""

    paths: list[Path]  # each without its sensor's bias
    graph: PoseGraph
    stated: SlamConfig
    maker: BaseMaker | None = None  # prepares stretches; None if the field is constant and gives no information
    # List of (bias, sd): of each log's magnetometer, in its own axes, T
    biases: list[tuple[Vector3, Vector3]] = field(default_factory=list)
    # List of (Anchor, int): fixed points, and the log that passed each
    anchors: list[tuple[Anchor, int]] = field(default_factory=list)
    steps: Steps = field(default_factory=Steps)  # where intermediate results are stored
    # Candidates of each window where the graph last predicted it
    looked: dict[int, list[Candidate]] = field(default_factory=dict)
    # Of each window, the stretches that were searched for it
    searched: dict[int, dict[int, Searched]] = field(default_factory=dict)
    # Stretches as bases; whole logs as bases, with how many closures they were corrected by
    made: dict[tuple[int, int], Base] = field(default_factory=dict)
    far: dict[int, tuple[int, Base]] = field(default_factory=dict)

    def copied(self) -> "Places":
        """A copy, to continue from without changing this one."""
        maker = None if self.maker is None else replace(self.maker)
        return Places(list(self.paths), self.graph.copied(), self.stated, maker, list(self.biases), self.anchors)

    def add(self, survey: Survey) -> Path:
        """Cut one more log into windows, in a frame of its own."""
        assert self.maker is not None
        bias = sensor_bias(survey, self.maker.numbers, self.maker.config)
        unbiased = without_bias(survey, bias[0])
        (path,) = cut([unbiased], self.maker.length, self.maker.config, len(self.paths), len(self.graph.p))
        self.biases.append(bias)
        self.paths.append(path)
        self.solve()
        return path

    def solve(self) -> None:
        """Poses of all nodes, those of the last log's new windows too."""
        follow(self.paths[-1], self.graph)
        if self.anchors:
            self.graph.fixed = fixed_points(self.anchors, self.paths)
        solve(self.graph)

    def close(self, paths: Sequence[Path]) -> None:
        """Search for closures of some logs until none is found."""
        for _ in range(MOST_ROUNDS):
            if not (self.close_near(paths) + self.close_far(paths)):
                break

    def close_near(self, paths: Sequence[Path], enough: float = np.inf) -> int:
        """Search for closures where the graph predicts them, until there are enough; returns how many were found.

        A few windows at a time: what they close is known when the graph predicts those that follow.
        """
        found, n = 0, self.graph.config.run_length
        for path in paths:
            candidates: list[list[Candidate]] = []
            for w in counted(f"looking for closures of {path.survey.name}", path.windows):
                candidates.append(self.near(w))
                if len(candidates) % n == 0 or w is path.windows[-1]:
                    found += self.tie(replace(path, windows=path.windows[: len(candidates)]), candidates)
                    if found >= enough:
                        return found
        return found

    def close_far(self, paths: Sequence[Path]) -> int:
        """Search for closures between unconnected logs, without a prior; returns how many were found."""
        found = 0
        for path in paths:
            # Whoever came first is the base; a log that was tied since is corrected as the graph has it.
            if self.others(path):
                what = f"looking for {path.survey.name} in other logs"
                found += self.connect(path, [self.anywhere(w, path) for w in counted(what, path.windows)])
        return found

    def connect(self, path: Path, candidates: list[list[Candidate]], whole: Path | None = None) -> int:
        """Add the certain closures with other components, if all of the log's windows say that the frame is shared.

        The candidates are of a whole log's windows, or of its last ones. Returns how many closures were found.
        """
        whole, component, found = whole or path, self.graph.component(), 0
        proposed = tie(path, candidates, self.graph, self.paths)
        log_prior = {w.node: c[0].match.log_prior for w, c in zip(path.windows, candidates, strict=True) if c}
        for one in sorted({int(component[c.first]) for c in proposed}):
            closures = [c for c in proposed if component[c.first] == one]
            before, self.graph = self.graph, self.graph.copied()
            self.graph.closures += closures
            solve(self.graph)
            nodes = np.flatnonzero(component == one)
            near = [self.at(w, nodes) for w in whole.windows]
            others = [p for p in self.paths if component[p.first_node] == one]
            priors = {c.second: log_prior[c.second] for c in closures}
            odds = log_odds_shared(whole, others, near, priors, self.graph)
            log.info("%s in the frame of %s: log odds %.1f", whole.survey.name, others[0].survey.name, odds)
            if odds >= SURE_ODDS:
                found += len(closures) + self.tie(whole, near, {c.second for c in self.graph.closures})
            else:
                self.graph = before
        return found

    def near(self, window: Window) -> list[Candidate]:
        """Where a window may lie on earlier path, as the graph predicts, except on passes that it is tied to."""
        component = self.graph.component()
        nodes = np.flatnonzero(component == component[window.node])
        found = self.looked[window.node] = self.at(window, nodes[~self.graph.is_tied(nodes, window.node)])
        return found

    def at(self, window: Window, nodes: Indices) -> list[Candidate]:
        """Where a window may lie near some nodes, of those before it, as the graph predicts."""
        expected = nearby(window, nodes[nodes < window.node], self.graph)
        searched = self.searched.setdefault(window.node, {})
        before = {
            a: searched[a]
            for a, rough in expected.items()
            if a in searched and searched[a].holds(rough, window.T_log_node)
        }

        def look() -> list[Candidate]:
            return near_candidates(window, expected, before, self.graph, self.stretch)

        found = of_numbers(self.steps(lambda: numbers_of(look())))
        for a, rough in expected.items():
            where = before[a].expected if a in before else rough
            searched[a] = Searched(where, [c.match.T_base_log for c in found if c.node == a])
        return found

    def others(self, path: Path) -> list[Path]:
        """Earlier logs that nothing ties to this one."""
        component = self.graph.component()
        earlier = [p for p in self.paths if p.first_node < path.first_node]
        return [p for p in earlier if component[p.first_node] != component[path.first_node]]

    def anywhere(self, window: Window, path: Path) -> list[Candidate]:
        """Where a window may lie on other logs, without a prior."""

        def look() -> list[Candidate]:
            bases = [self.whole(other) for other in self.others(path)]
            return far_candidates(window, bases, self.graph)

        return of_numbers(self.steps(lambda: numbers_of(look())))

    def tie(self, path: Path, candidates: list[list[Candidate]], but: Collection[int] = ()) -> int:
        """Add certain closures, one a pass, except those of some windows, and solve; returns how many were found."""
        closures = [
            c
            for c in tie(path, candidates, self.graph, self.paths)
            if c.second not in but and not self.graph.is_tied(np.array([c.first]), c.second).any()
        ]
        self.graph.closures += closures
        if closures:
            solve(self.graph)
        return len(closures)

    def stretch(self, node: int, before: int) -> Base:
        """A window and its neighbours as a base for a later window, odometry's frame."""
        assert self.maker is not None
        path = self.paths[self.graph.log[node]]
        key = node, min(node + 1, before - 1)
        base = self.made.pop(key, None)
        if base is None:
            first, last = np.searchsorted(path.number, np.array([node - 1, key[1] + 1]) - path.first_node)
            rows = np.arange(first, last)
            base = self.maker.make(path.survey.subset(rows), path.nodes[path.number[rows]])
        # The one used last stands last.
        self.made[key] = base
        if len(self.made) > MOST_BASES:
            del self.made[next(iter(self.made))]
        return base

    def whole(self, path: Path) -> Base:
        """A whole log as a base, as the graph has it now."""
        assert self.maker is not None
        n, base = self.far.get(path.first_node, (-1, None))
        if base is None or n != len(self.graph.closures):
            base = self.maker.make(corrected(path, self.graph), path.nodes[path.number])
            self.far[path.first_node] = len(self.graph.closures), base
        return base

    def learn_noise(self) -> None:
        """Learn the noise that does not repeat from closures, and where the graph alone says what is passed again."""
        assert self.maker is not None
        stretches = [s for s in self._repeats() if len(s.positions) >= MIN_BINS]
        if len(stretches) < PRIOR_STRETCHES:
            return
        self.maker.noise = most_likely(self.maker.noise, stretches)
        log.info("noise learned from %d closures: %s", len(stretches), self.maker.noise)
        self.made = {key: base.with_noise(self.maker.noise) for key, base in self.made.items()}
        self.far.clear()

    def learn_drift(self) -> None:
        """Learn how far odometry drifts from how well its closures agree with it."""
        assert self.maker is not None
        config = learned_drift(self.graph, self.paths, self.stated)
        self.maker.config = self.graph.config = config
        self.paths = [replace(p, windows=tuple(replace(w, config=config) for w in p.windows)) for p in self.paths]
        self.graph.edges = odometry_graph(self.paths, config).edges
        log.info("odometry drifts by %.2g m and %.2g deg in 10 m", *config.odometry.sd)

    def _repeats(self) -> Iterator[Stretch]:
        windows = {w.node: w for path in self.paths for w in path.windows}
        pairs = {(c.first, c.second): c.T_first_second for c in self.graph.closures}
        closed = {second for _, second in pairs}
        for node, candidates in self.looked.items():
            if candidates and node not in closed:
                best = max(candidates, key=lambda c: c.match.log_odds)
                C = self.graph.relative_covariances(np.array([best.node]), node)[0]
                if np.linalg.eigvalsh(C[3:, 3:])[-1] < (SAME_SHIFT * windows[node].length) ** 2:
                    pairs[best.node, node] = best.T_node_window
        for (first, second), T in pairs.items():
            window = windows[second]
            T_base_log = self.graph.center(first) * T * window.T_log_node.inv()
            yield residuals(window, self.stretch(first, second), T_base_log)


def settled(given: Sequence[Survey], config: SlamConfig) -> SlamConfig:
    """Settings with what the logs show of themselves: whether they lie level."""
    if not config.is_gravity_aligned or config.is_planar or not lie_level(given):
        return config
    log.info("all poses lie at one height: taken as planar")
    return config.model_copy(update={"is_planar": True})


def begin(given: Sequence[Survey], config: SlamConfig) -> Places:
    """Logs cut into windows, as odometry has them, and the numbers of the field that they share."""
    if all(survey.field.std(axis=0).max() < CONSTANT_FIELD for survey in given):
        # Nothing tells places apart, and the field has no length.
        paths = cut(given, max(float(extent(survey).max()) for survey in given), config)
        return Places(paths, odometry_graph(paths, config), config, None, [NO_BIAS] * len(given))
    tell("learning how the field changes")
    numbers, length = shared_numbers(given)
    biases = [sensor_bias(survey, numbers, config) for survey in given]
    paths = cut([without_bias(survey, bias) for survey, (bias, _) in zip(given, biases, strict=True)], length, config)
    n_windows, walked = sum(len(p.windows) for p in paths), config.window_length * length
    log.info("field length %.2f m; %d windows of %.1f m", length, n_windows, walked)
    maker = BaseMaker(numbers, guessed_noise(numbers, length), length, config)
    return Places(paths, odometry_graph(paths, config), config, maker, biases)


def find(
    given: Sequence[Survey],
    config: SlamConfig,
    anchors: Sequence[tuple[Anchor, int]] = (),
    steps: Steps | None = None,
    clock: Clock | None = None,
) -> Places:
    """All logs at once: the noise is learned from the most certain closures; then all are searched again with it."""
    clock = clock or Clock()
    with one_blas_thread():
        with clock("numbers"):
            places = begin(given, config)
        places.steps, places.anchors = steps or Steps(), list(anchors)
        places.solve()
        if places.maker is not None:
            with clock("noise"):
                places.close_near(places.paths, ENOUGH)
                places.learn_noise()
                places.learn_drift()
                forget_closures(places.graph)
            with clock("closures"):
                places.close(places.paths)
                places.learn_drift()
                places.solve()
    return places


def go_on(
    earlier: Places, logs: Sequence[Survey], anchors: Sequence[tuple[Anchor, int]], steps: Steps, clock: Clock
) -> Places:
    """Add logs with the known hyperparameters; closures between earlier logs are kept."""
    places = earlier.copied()
    places.steps, places.anchors = steps, [*places.anchors, *anchors]
    with one_blas_thread(), clock("closures"):
        places.solve()
        for survey in logs:
            if places.graph.config.is_planar and not lie_level([survey]):
                log.warning("%s: does not lie level, and is taken as planar like the logs before it", survey.name)
            places.close([places.add(survey)])
    return places
