# SPDX-License-Identifier: BSD-3-Clause
"""Windows of logs and their graph, and rounds of search for loop closures."""

import logging
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np
from scipy.special import logit

from magmatch.data.survey import Survey
from magmatch.progress import counted
from magmatch.registration.prepared.path_noise import PRIOR_STRETCHES, Stretch, most_likely
from magmatch.registration.prepared.walk import MIN_BINS
from magmatch.registration.search.pair_search import PairTable
from magmatch.registration.search.retrieval import count_votes, shortlist
from magmatch.slam.config import SlamConfig
from magmatch.slam.decide.shared_frame_odds import log_odds_shared
from magmatch.slam.decide.tie import tie
from magmatch.slam.graph.anchors import Anchor, fixed_points
from magmatch.slam.graph.doubt import surprise_before
from magmatch.slam.graph.factors import LEAST_KEPT, Closure
from magmatch.slam.graph.learned_drift import learned_drift
from magmatch.slam.graph.odometry import follow, odometry_graph
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.solve import solve
from magmatch.slam.graph.trajectories import moved
from magmatch.slam.search.bases import TOGETHER, Base, BaseMaker, stretch_of
from magmatch.slam.search.candidates import Candidate, numbers_of, of_numbers
from magmatch.slam.search.comparison import Comparison, Found, Search, Searched, candidate, compare
from magmatch.slam.search.loop_closure import residuals
from magmatch.slam.search.predicted import SURE, earlier_passes, is_known, nearby
from magmatch.slam.sensor_bias import in_one_calibration, sensor_bias, without_bias
from magmatch.slam.steps import Steps
from magmatch.slam.windows import Path, Window, cut
from magmatch.typing import Indices, Mask, Matrix, Points, Vector3

log = logging.getLogger(__name__)

# Closures make others possible: maximum number of rounds of search.
MOST_ROUNDS = 4
# So sure must be what teaches noise, and that logs share a frame.
SURE_ODDS = float(logit(SURE))
# Of the noise what a base itself states: closures' poses were fitted to the same residuals, mostly near its path.
MAPS_OWN = ("map_factor", "map_length")
# Passes that a window is compared with. Its closures have an error in common, so n of them tell 3 n / (n + 1) times
# what one tells (`counted`): four tell four fifths of all.
MOST_PASSES = 4


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
    # Of each window, how the stretches that were asked for it voted, and those that were searched for it
    voted: dict[int, dict[int, float]] = field(default_factory=dict)
    searched: dict[int, dict[int, Searched]] = field(default_factory=dict)

    def copied(self) -> "Places":
        """A copy, to continue from without changing this one."""
        maker = None if self.maker is None else replace(self.maker, run=None)
        return Places(list(self.paths), self.graph.copied(), self.stated, maker, list(self.biases), self.anchors)

    def add(self, survey: Survey) -> Path:
        """Cut one more log into windows, in a frame of its own."""
        assert self.maker is not None
        survey = in_one_calibration(survey)
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
        """Search for closures of some logs until none is found, each time with the drift that those so far show."""
        for k in range(MOST_ROUNDS):
            if not (self.close_near(paths, at_once=k > 0) + self.close_far(paths)):
                break
            self.learn_drift()

    def close_near(
        self, paths: Sequence[Path], enough: float = np.inf, least: float = LEAST_KEPT, *, at_once: bool = False
    ) -> int:
        """Search for closures where the graph predicts them, until there are enough; returns how many were found.

        They must be more probable than ``least``.

        A few windows at a time: what they close is known when the graph predicts those that follow. Windows long past
        were weighed by what the graph knew then, so they have no more say. Or all of a log ``at_once``: where it was
        searched before, the graph predicts all of them, and is solved once.
        """
        found, few = 0, self.graph.config.run_length
        for path in paths:
            candidates: list[list[Candidate]] = []
            for some in counted(f"looking for closures of {path.survey.name}", in_runs(path.windows, few)):
                candidates += self.near(some)
                if at_once and len(candidates) < len(path.windows):
                    continue
                first = 0 if at_once else max(len(candidates) - 2 * few, 0)
                found += self.tie(path.only(slice(first, len(candidates))), candidates[first:], least=least)
                if found >= enough:
                    return found
        return found

    def close_far(self, paths: Sequence[Path]) -> int:
        """Search for closures between unconnected logs, without a prior; returns how many were found."""
        found = 0
        for path in paths:
            # Whoever came first is the base; a log that was tied since is corrected as the graph has it.
            if self.others(path):
                runs = in_runs(path.windows, self.graph.config.run_length)
                what = f"looking for {path.survey.name} in other logs"
                found += self.connect(path, [c for some in counted(what, runs) for c in self.anywhere(some, path)])
        return found

    def connect(self, path: Path, candidates: list[list[Candidate]], whole: Path | None = None) -> int:
        """Add the probable closures with other components, if all of the log's windows say that the frame is shared.

        The candidates are of a whole log's windows, or of its last ones. Returns how many closures were found.
        """
        whole, component, found = whole or path, self.graph.component(), 0
        proposed = tie(path, candidates, self.graph, self.paths)
        for one in sorted({int(component[c.first]) for c in proposed}):
            closures = [c for c in proposed if component[c.first] == one]
            nodes = np.flatnonzero(component == one)
            near = self.confirm(whole.windows, nodes, closures, _log_priors(path, candidates, closures))
            if near is not None:
                found += len(closures) + self.tie(whole, near, {c.second for c in self.graph.closures})
        return found

    def confirm(
        self, windows: Sequence[Window], nodes: Indices, closures: list[Closure], log_prior: dict[int, float]
    ) -> list[list[Candidate]] | None:
        """Add closures from nowhere with some nodes if windows say so; gives where these then lie, None if not.

        ``log_prior``: for each window that proposes a closure, the density of the prior that it was found with.
        """
        before, self.graph = self.graph, self.graph.copied()
        self.graph.closures = [*self.graph.closures, *closures]
        solve(self.graph)
        runs = in_runs(windows, self.graph.config.run_length)
        near = [found for some in runs for found in self.at(some, [nodes] * len(some))]
        known = np.concatenate([self._moved(path, np.isin(path.nodes, nodes)[path.number]) for path in self.paths])
        odds = log_odds_shared(windows, known, near, log_prior, self.graph)
        log.info("windows %d to %d on known path: log odds %.1f", windows[0].node, windows[-1].node, odds)
        if odds >= SURE_ODDS:
            return near
        self.graph = before
        return None

    def _moved(self, path: Path, rows: Mask) -> Points:
        """Some samples' positions, as the graph has them."""
        return moved(path, self.graph, path.walked[rows], path.survey.positions[rows])

    def near(self, windows: Sequence[Window]) -> list[list[Candidate]]:
        """Where windows may lie on earlier path, as the graph predicts, except on passes that they are tied to."""
        asked = []
        for window in windows:
            nodes = self.known_to(window)
            if (self.graph.ties.second == window.node).sum() >= MOST_PASSES:
                nodes = nodes[:0]
            asked.append(nodes[~self.graph.is_tied(nodes, window.node)])
        found = self.at(windows, asked)
        self.looked.update(zip((window.node for window in windows), found, strict=True))
        return found

    def at(self, windows: Sequence[Window], nodes: Sequence[Indices]) -> list[list[Candidate]]:
        """Where each window may lie near some nodes, of those before it, as the graph predicts.

        None of them waits for what is found of another, so all are compared at once.
        """
        near = [self.stretches(nearby(w, some, self.graph), w) for w, some in zip(windows, nodes, strict=True)]
        self.ask_for({a for some in near for a in some})
        self.vote({w: list(some) for w, some in zip(windows, near, strict=True) if len(some) > MOST_PASSES})
        searches = [
            Search.of(w, few, self.searched.setdefault(w.node, {}), self.graph)
            for w, few in zip(windows, map(self.most_voted, windows, near), strict=True)
        ]

        def look() -> list[list[Candidate]]:
            assert self.maker is not None
            pairs = [(k, a) for k, search in enumerate(searches) for a in search.open]
            bases = self.maker.given([(self.path(a), a) for _, a in pairs])
            asked = [
                searches[k].comparison(a, base, self.maker.noise) for (k, a), base in zip(pairs, bases, strict=True)
            ]
            compared: list[dict[int, Found]] = [{} for _ in searches]
            for (k, a), some in zip(pairs, self.maker.apply(compare, asked), strict=True):
                compared[k][a] = some
            return [search.candidates(some, self.graph) for search, some in zip(searches, compared, strict=True)]

        found = self.found_in_steps(len(windows), look)
        for search, some in zip(searches, found, strict=True):
            self.searched[search.window.node].update(search.done(some))
        return found

    def ask_for(self, nodes: Collection[int]) -> None:
        """Tell what makes the stretches of some nodes, whether or not they need be made after an interruption."""
        assert self.maker is not None
        for node in nodes:
            self.maker.task(self.path(node), node)

    def stretches(self, nodes: Indices, window: Window) -> dict[int, Indices]:
        """Nodes by the stretch that was made for them, which the first of these names, if it ends before a window."""
        logs = self.graph.log[nodes]
        firsts = stretch_of(nodes, np.array([path.first_node for path in self.paths])[logs])
        ends_before = (logs != window.log) | (firsts + TOGETHER < window.node)
        return {a: nodes[firsts == a] for a in np.unique(firsts[ends_before]).tolist()}

    def vote(self, asked: dict[Window, list[int]]) -> None:
        """Let stretches vote for each window that may lie on them, by their nodes; none is asked twice.

        A vote is the share of the window's pairs of points that agree on one pose there.
        """
        new = {
            w: [node for node in some if node not in self.voted.setdefault(w.node, {})] for w, some in asked.items()
        }

        @cache
        def tables() -> dict[int, PairTable]:
            assert self.maker is not None
            nodes = sorted({node for some in new.values() for node in some})
            return dict(zip(nodes, self.maker.tables([(self.path(node), node) for node in nodes]), strict=True))

        def ask(window: Window) -> Matrix:
            listed = [tables()[node] for node in new[window]]
            return count_votes(listed, window.survey, self.graph.config.search, 0)[None]

        for window, some in new.items():
            if some:
                votes = self.steps(partial(ask, window))[0]
                self.voted[window.node].update(zip(some, votes.tolist(), strict=True))

    def most_voted(self, window: Window, stretches: dict[int, Indices]) -> dict[int, Indices]:
        """The stretches that a window is compared with: of many, those with most votes."""
        if len(stretches) <= MOST_PASSES:
            return stretches
        listed, votes = list(stretches), self.voted[window.node]
        likely = shortlist(np.array([votes[a] for a in listed]))[:MOST_PASSES]
        return {listed[k]: stretches[listed[k]] for k in likely}

    def others(self, path: Path) -> list[Path]:
        """Earlier logs that nothing ties to this one."""
        component = self.graph.component()
        earlier = [p for p in self.paths if p.first_node < path.first_node]
        return [p for p in earlier if component[p.first_node] != component[path.first_node]]

    def anywhere(self, windows: Sequence[Window], path: Path) -> list[list[Candidate]]:
        """Where windows of a log may lie on other logs, without a prior."""
        others = self.others(path)

        def look() -> list[list[Candidate]]:
            assert self.maker is not None
            bases, volume = self.maker.whole(others, self.graph)
            pairs = [(k, base) for k, w in enumerate(windows) if w.keeps_shape for base in bases]
            asked = [Comparison(windows[k], base, volume, self.maker.noise) for k, base in pairs]
            found: list[list[Candidate]] = [[] for _ in windows]
            for (k, _), some in zip(pairs, self.maker.apply(compare, asked), strict=True):
                found[k] += [candidate(windows[k], node, match, self.graph.pose(node)) for node, match in some]
            return found

        return self.found_in_steps(len(windows), look)

    def found_in_steps(self, n: int, look: Callable[[], list[list[Candidate]]]) -> list[list[Candidate]]:
        """What a search finds for each of n windows, a step each, or found before an interruption."""
        found = cache(look)

        def step(k: int) -> Matrix:
            return numbers_of(found()[k])

        return [of_numbers(self.steps(partial(step, k))) for k in range(n)]

    def tie(
        self, path: Path, candidates: list[list[Candidate]], but: Collection[int] = (), least: float = LEAST_KEPT
    ) -> int:
        """Add probable closures, one a pass, except those of some windows, and solve; returns how many were found."""
        closures = [
            c
            for c in tie(path, candidates, self.graph, self.paths, least)
            if c.second not in but and not self.graph.is_tied(np.array([c.first]), c.second).any()
        ]
        closures = [replace(c, paid=surprise_before(self.graph, c)) for c in closures]
        lost = [c for c in closures if self.is_lost(c)]
        closures = [c for c in closures if c not in lost]
        self.graph.closures = [*self.graph.closures, *closures]
        if closures:
            solve(self.graph)
        return len(closures) + self.find_lost(path, candidates, lost)

    def find_lost(self, path: Path, candidates: list[list[Candidate]], closures: list[Closure]) -> int:
        """Add closures of a log's last windows that may lie anywhere, if all of those say so; returns how many."""
        if not closures:
            return 0
        nodes, log_prior = self.known_to(path.windows[0]), _log_priors(path, candidates, closures)
        return 0 if self.confirm(path.windows, nodes, closures, log_prior) is None else len(closures)

    def known_to(self, window: Window) -> Indices:
        """Earlier nodes that share a window's frame."""
        component = self.graph.component()
        return earlier_passes(window, np.flatnonzero(component == component[window.node]), self.graph)

    def is_lost(self, closure: Closure) -> bool:
        """Whether the graph does not know which stretch a closure's window lies on."""
        half = self.window(closure.second).path_length / 2
        return bool(self.graph.sds_of_place(np.array([closure.first]), closure.second)[0] > half)

    def stretch(self, node: int) -> Base:
        """A window and its neighbours as a base for later windows, odometry's frame."""
        assert self.maker is not None
        return self.maker.stretch(self.path(node), node)

    def path(self, node: int) -> Path:
        """The log that a node lies on."""
        return self.paths[int(self.graph.log[node])]

    def window(self, node: int) -> Window:
        """The window of a node."""
        path = self.path(node)
        return path.windows[node - path.first_node]

    def learn_noise(self) -> None:
        """Learn the noise that does not repeat from closures, and where the graph alone says what is passed again."""
        assert self.maker is not None
        stretches = [s for s in self._repeats() if len(s.positions) >= MIN_BINS]
        if len(stretches) < PRIOR_STRETCHES:
            return
        self.maker.learn(most_likely(self.maker.noise, stretches, MAPS_OWN))
        self._weigh_anew()
        log.info("noise learned from %d closures: %s", len(stretches), self.maker.noise)

    def learn_drift(self) -> None:
        """Learn how far odometry drifts from how well its closures agree with it, and solve with that.

        A closure that few others spoke for when it was found is believed again, with those found since.
        """
        assert self.maker is not None
        self.graph.weigh_closures(np.ones(len(self.graph.closures)))
        self.solve()
        config = learned_drift(self.graph, self.paths, self.stated)
        self.maker.config = self.graph.config = config
        self.paths = [replace(p, windows=tuple(replace(w, config=config) for w in p.windows)) for p in self.paths]
        self.graph.edges = odometry_graph(self.paths, config).edges
        self._weigh_anew()
        log.info("odometry drifts by %.2g m and %.2g deg in 10 m", *config.odometry.sd)
        self.solve()

    def _weigh_anew(self) -> None:
        """Weigh again what was searched, as noise or drift are known otherwise now."""
        assert self.maker is not None
        self.maker.forget_whole()
        self.searched = {
            node: {a: replace(s, weighed=None) for a, s in known.items()} for node, known in self.searched.items()
        }

    def _repeats(self) -> Iterator[Stretch]:
        pairs = {(c.first, c.second): c.T_first_second for c in self.graph.closures}
        closed = {second for _, second in pairs}
        for node, candidates in self.looked.items():
            if candidates and node not in closed:
                best = max(candidates, key=lambda c: c.match.log_odds)
                if is_known(self.window(node), np.array([best.node]), self.graph):
                    pairs[best.node, node] = best.T_node_window
        assert self.maker is not None
        bases = self.maker.make([(self.path(first), first) for first, _ in pairs])
        for ((first, second), T), base in zip(pairs.items(), bases, strict=True):
            window = self.window(second)
            yield residuals(window, base, self.graph.center(first) * T * window.T_log_node.inv())


def _log_priors(path: Path, candidates: list[list[Candidate]], closures: list[Closure]) -> dict[int, float]:
    """Of each window that proposes a closure, the density of the prior at its pose."""
    found = {c.second: candidates[c.second - path.first_node] for c in closures}
    return {c.second: next(k.match.log_prior for k in found[c.second] if k.node == c.first) for c in closures}


def in_runs(windows: Sequence[Window], n: int) -> list[Sequence[Window]]:
    """Windows in runs of so many."""
    return [windows[k : k + n] for k in range(0, len(windows), n)]
