# SPDX-License-Identifier: BSD-3-Clause
"""The search for candidates: windows are compared with earlier path, where it was not done before."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from magmatch.estimation.path_noise import Stretch
from magmatch.registration.search.pair_search import PairTable
from magmatch.registration.search.retrieval import count_votes, shortlist
from magmatch.runner import Runner, Shared
from magmatch.slam.config import MOST_PASSES
from magmatch.slam.places import Places
from magmatch.slam.search.loop_closure import (
    Anywhere,
    Candidate,
    Found,
    Match,
    Rough,
    compare,
    expected_beside,
    is_known,
    nearby,
    residuals,
)
from magmatch.slam.search.searched import Searched, distinct_candidates
from magmatch.slam.search.submaps import TOGETHER, Submap, SubmapMaker, submap_of, table_of, volume_of
from magmatch.slam.windows import Path, Window
from magmatch.typing import Indices
from magmatch.workers import Task

# Classes that a runner keeps of a search.
KINDS = (Match, Stretch)


@dataclass(eq=False, slots=True)
class LoopSearch:
    """Compares windows with submaps where the graph predicts them, or with whole logs."""

    places: Places
    run: Runner
    # Submaps that were asked for, by their first node: made with the noise that was known then; and their pairs
    _submaps: dict[int, Shared[Submap]] = field(default_factory=dict, init=False)
    _tables: dict[int, PairTable] = field(default_factory=dict, init=False)
    # Whole logs, by their first node: how many closures corrected them, and their volumes (m^3)
    _whole: dict[int, tuple[int, Shared[Submap], float]] = field(default_factory=dict, init=False)
    # For each window, how the submaps that were asked for it voted, and those that were searched for it
    _voted: dict[int, dict[int, float]] = field(default_factory=dict, init=False)
    searched: dict[int, dict[int, Searched]] = field(default_factory=dict, init=False)
    # Candidates of each window where the graph last predicted it
    predicted: dict[int, list[Candidate]] = field(default_factory=dict, init=False)

    @property
    def maker(self) -> SubmapMaker:
        """The maker of submaps."""
        assert self.places.maker is not None
        return self.places.maker

    def near(self, windows: Sequence[Window], what: str | None = None) -> list[list[Candidate]]:
        """Find where windows may lie on earlier path, as the graph predicts; not on passes that they close with."""
        asked, graph = [], self.places.graph
        for window in windows:
            nodes = self.places.known_to(window)
            if (graph.as_arrays.second == window.node).sum() >= MOST_PASSES:
                nodes = nodes[:0]
            asked.append(nodes[~graph.has_closure(nodes, window.node)])
        found = self.at(windows, asked, what)
        self.predicted.update(zip((window.node for window in windows), found, strict=True))
        return found

    def at(
        self, windows: Sequence[Window], nodes: Sequence[Indices], what: str | None = None
    ) -> list[list[Candidate]]:
        """Find where each window may lie near some earlier nodes, of those that the graph predicts.

        None of them waits for what is found of another, so all are compared at once; ``what`` tells progress.
        """
        graph, expected, pairs, tasks = self.places.graph, list[dict[int, Rough]](), [], []
        near = [self._by_likely_submap(nearby(w, some, graph), w) for w, some in zip(windows, nodes, strict=True)]
        for w, by_submap in zip(windows, near, strict=True):
            known = self.searched.setdefault(w.node, {})
            expected.append(expected_beside(w, np.array(list(by_submap), np.int64), graph))
            for a, rough in expected[-1].items():
                # What was searched before is not searched again, and where it still stands it is not weighed either.
                if a in known and not known[a].holds(rough, by_submap[a], w):
                    del known[a]
                if a not in known or not known[a].stands(rough, w):
                    poses = [c.match.T_base_log for c in known[a].found] if a in known else None
                    name = f"the comparison of window {w.node} with windows {a} and after"
                    pairs.append((w.node, a))
                    tasks.append(Task(name, (w, self.submap(a), rough, self.maker.noise, poses, by_submap[a])))
        compared = dict(zip(pairs, self.run(compare, tasks, what), strict=True))
        about = zip(windows, near, expected, strict=True)
        return [self._found(w, by_submap, rough, compared) for w, by_submap, rough in about]

    def _found(
        self,
        window: Window,
        near: dict[int, Indices],
        expected: dict[int, Rough],
        compared: dict[tuple[int, int], Found],
    ) -> list[Candidate]:
        """Candidates of a window on submaps near it, by what was found there now or stands; this is noted."""
        graph, known = self.places.graph, self.searched[window.node]
        opened = [a for a in expected if (window.node, a) in compared]
        some = {a: known[a].found for a in expected if a not in opened}
        for a in opened:
            beside = compared[window.node, a]
            some[a] = [Candidate.beside(node, match, window, graph.center(node)) for node, match in beside]
        found = distinct_candidates((c for a in expected for c in some[a]), graph, window.length)
        for a in opened:
            before = known.get(a, Searched(near[a], expected[a], None, []))
            known[a] = replace(before, weighed=expected[a], found=[c for c in found if c.node in near[a]])
        return found

    def anywhere(self, windows: Sequence[Window], path: Path, what: str | None = None) -> list[list[Candidate]]:
        """Find where windows of a log may lie on unconnected logs, without a prior."""
        (whole, volume), noise = self._whole_logs(self.places.others(path)), self.maker.noise
        pairs = [(k, one) for k, w in enumerate(windows) if w.keeps_shape for one in whole]
        found: list[list[Candidate]] = [[] for _ in windows]
        name, pose = "the comparison of window {} with a whole log", self.places.graph.pose
        tasks = [Task(name.format(windows[k].node), (windows[k], one, Anywhere(volume), noise)) for k, one in pairs]
        for (k, _), some in zip(pairs, self.run(compare, tasks, what), strict=True):
            found[k] += [Candidate.beside(node, match, windows[k], pose(node)) for node, match in some]
        return found

    def submap(self, node: int) -> Shared[Submap]:
        """The submap that is made for a node's window, odometry's frame."""
        path = self.places.path(node)
        first = submap_of(node, path.first_node)
        if first not in self._submaps:
            self._submaps[first] = self.maker.piece(path, first)
        return self._submaps[first]

    def _by_likely_submap(self, nodes: Indices, window: Window) -> dict[int, Indices]:
        """Nodes by submap, as `by_submap`; of many submaps, those with most votes."""
        submaps = self.by_submap(nodes, window)
        if len(submaps) <= MOST_PASSES:
            return submaps
        listed, votes = list(submaps), self.votes(window, list(submaps))
        likely = shortlist(np.array([votes[a] for a in listed]))[:MOST_PASSES]
        return {listed[k]: submaps[listed[k]] for k in likely}

    def by_submap(self, nodes: Indices, window: Window) -> dict[int, Indices]:
        """Nodes by the first node of the submap that is made for them, if that ends before a window."""
        logs = self.places.graph.log[nodes]
        firsts = submap_of(nodes, np.array([path.first_node for path in self.places.paths])[logs])
        ends_before = (logs != window.log) | (firsts + TOGETHER < window.node)
        return {a: nodes[firsts == a] for a in np.unique(firsts[ends_before]).tolist()}

    def votes(self, window: Window, submaps: Sequence[int]) -> dict[int, float]:
        """Votes of submaps, by their first nodes, for a window; none is asked twice.

        A vote is the share of the window's pairs of points that agree on one pose there.
        """
        voted = self._voted.setdefault(window.node, {})
        if new := [a for a in submaps if a not in voted]:
            unknown = [a for a in new if a not in self._tables]
            tasks = [Task(f"the map of windows {a} to {a + TOGETHER - 1}", (self.submap(a),)) for a in unknown]
            self._tables.update(zip(unknown, self.run(table_of, tasks, keep=False), strict=True))
            tables = [self._tables[a] for a in new]
            counted = count_votes(tables, window.survey, 0)
            voted.update(zip(new, counted.tolist(), strict=True))
        return voted

    def _whole_logs(self, paths: Sequence[Path]) -> tuple[list[Shared[Submap]], float]:
        """Whole logs, as the graph had them with as many closures as it has now, and their volume together, m^3."""
        n = len(self.places.graph.closures)
        new = [path for path in paths if self._whole.get(path.first_node, (-1,))[0] != n]
        made = [self.maker.whole(path, self.places.graph) for path in new]
        volumes = self.run(volume_of, [Task("the map of a whole log", (one,)) for one in made])
        for path, one, volume in zip(new, made, volumes, strict=True):
            self._whole[path.first_node] = n, one, volume
        found = [self._whole[path.first_node] for path in paths]
        return [one for _, one, _ in found], float(sum(volume for *_, volume in found))

    def repeats(self) -> list[Stretch]:
        """Residuals of windows where the field was seen before: by closures, and where the graph alone knows that."""
        graph = self.places.graph
        pairs = {(c.first, c.second): c.T_first_second for c in graph.closures}
        closed = {second for _, second in pairs}
        for node, candidates in self.predicted.items():
            if candidates and node not in closed:
                best = max(candidates, key=lambda c: c.match.log_odds)
                if is_known(self.places.window(node), np.array([best.node]), graph):
                    pairs[best.node, node] = best.T_node_window
        tasks = []
        for (first, second), T in pairs.items():
            window = self.places.window(second)
            T_submap_log = graph.center(first) * T * window.T_log_node.inv()
            tasks.append(Task(f"what window {second} repeats", (window, self.submap(first), T_submap_log)))
        return list(self.run(residuals, tasks))

    def weigh_anew(self) -> None:
        """Weigh again what was searched, as noise or drift are known otherwise now."""
        self._whole.clear()
        self.searched = {
            node: {a: replace(s, weighed=None) for a, s in known.items()} for node, known in self.searched.items()
        }
