# SPDX-License-Identifier: BSD-3-Clause
"""Each window is compared once more, with one map of all passes beside it, instead of with each by itself.

A map beside a single line is a guess across it; beside several it is measured. The likelihood of a log is the
product, window by window, of that of a window given all before it, or given all after it: the mean of both is taken.
Passes of one log only: where several sensors contradict each other, a map of all shows a field that nobody measured.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform
from scipy.special import expit, logit

from magmatch.data.survey import Survey
from magmatch.estimation.walk import BIN_LENGTH, bin_along_path, bin_means
from magmatch.geometry import product, rotation_matrix
from magmatch.runner import Runner, Shared
from magmatch.slam.config import LEAST_KEPT, MOST_PASSES, SURE
from magmatch.slam.decide import off_level
from magmatch.slam.graph.factors import SubmapFactor
from magmatch.slam.graph.odometry import covariance_beside
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.solve import solve
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.places import Places
from magmatch.slam.search.loop_closure import SAME_SHIFT, Candidate, compare, expected_beside
from magmatch.slam.search.submaps import make_submap
from magmatch.slam.windows import Path, Window
from magmatch.typing import Indices, Scalars
from magmatch.workers import Task

log = logging.getLogger(__name__)

# Field lengths from a window's path beyond which the field there tells it nothing.
SUBMAP_REACH = 2.0
# Standard deviation, in field lengths, of a sample's weight by its distance from the window's path.
FADES = 0.5


@dataclass(frozen=True, eq=False, slots=True)
class JointSubmap:
    """Passes beside a window whose places relative to it the graph knows."""

    survey: Survey  # their samples, in odometry's frame as it was at the best known node
    node: Indices  # (n,): of each sample
    passes: Indices  # (k,): a node of each pass, and its share in the map where the window lies; the largest first
    shares: Scalars
    best_known: int  # the node relative to which the window's place is known best


class KnownPath:
    """Means of a log along its path, as the graph has it now."""

    def __init__(self, path: Path, graph: PoseGraph) -> None:
        survey, side = corrected(path, graph), BIN_LENGTH * path.windows[0].length
        rows = bin_along_path(np.ascontiguousarray(path.survey.positions), side)
        # In the frame of the log's component, (n, 3), m and T; and the node of each mean
        self.positions, self.field = bin_means(survey.positions, rows), bin_means(survey.field, rows)
        self.node = path.nodes[path.number[np.unique(rows, return_index=True)[1]]]
        # Samples of a mean, in the median
        self.n_averaged = float(np.median(np.bincount(rows)))

    def submap(self, window: Window, graph: PoseGraph, *, later: bool) -> JointSubmap | None:
        """Submap of a window, of earlier or of later passes; none if there are fewer than two.

        A map of one pass is what the window's closure with it was found on.
        """
        reach, b = SUBMAP_REACH * window.length, window.node
        nodes = np.arange(b + 1, self.node[-1] + 1) if later else np.arange(self.node[0], b)
        nodes = nodes[~graph.is_one_pass(nodes, b)]
        nodes = nodes[np.linalg.norm(graph.p[nodes] - graph.p[b], axis=1) < window.path_length + reach]
        rows = np.flatnonzero(np.isin(self.node, nodes))
        own = self.positions[self.node == b]
        apart = np.asarray(cKDTree(own).query(self.positions[rows], 1, 0, 2, reach)[0])
        rows, apart = rows[np.isfinite(apart)], apart[np.isfinite(apart)]
        near = np.unique(self.node[rows])
        if not len(near):
            return None
        sds = graph.sds_of_place(near, b)
        is_known = np.isin(self.node[rows], near[sds < SAME_SHIFT * window.length])
        rows, weight = rows[is_known], np.exp(-0.5 * (apart[is_known] / (FADES * window.length)) ** 2)
        passes, shares = _passes(self.node[rows], weight, graph)
        if len(passes) < 2:
            return None
        best = int(near[np.argmin(sds)])
        T_odometry_map = product(graph.center(best), graph.pose(best).inv())
        survey = Survey(self.positions[rows], self.field[rows]).transformed(T_odometry_map)
        return JointSubmap(survey, self.node[rows], passes, shares, best)


def _passes(node: Indices, weight: Scalars, graph: PoseGraph) -> tuple[Indices, Scalars]:
    """A node of each pass, and the pass's share, from the node and the weight of each sample; most weight first."""
    weights, left = np.bincount(node, weight), np.ones(len(node), bool)
    passes: list[int] = []
    shares: list[float] = []
    for one in np.argsort(-weights, kind="stable")[: np.count_nonzero(weights)].tolist():
        if len(passes) < MOST_PASSES and not any(graph.is_one_pass(one, other) for other in passes):
            mine = left & graph.is_one_pass(node, one)
            passes.append(one)
            shares.append(float(weight[mine].sum()))
            left &= ~mine
    return np.array(passes, np.int64), np.array(shares) / sum(shares)


def submap_factor(
    found: Candidate, node: int, submap: JointSubmap, graph: PoseGraph, path: Path
) -> SubmapFactor | None:
    """The factor of a pose that was found for a node's window; none if it is no more probable than not.

    The graph knows that the window lies there, as it does for closures near a place that is known.
    """
    probability = float(expit(found.match.log_odds + logit(SURE)))
    if probability <= LEAST_KEPT:
        return None
    T_map_node = product(graph.pose(submap.best_known), found.T_node_window, found.match.T_node_alone)
    T_passes_node = [product(graph.pose(one).inv(), T_map_node) for one in submap.passes.tolist()]
    covariance = found.match.covariance_alone + off_level(graph.config)
    for one, share, T in zip(submap.passes.tolist(), submap.shares, T_passes_node, strict=True):
        covariance = covariance + share**2 * covariance_beside(path, one, T, graph.config)
    R, t = np.stack([rotation_matrix(T) for T in T_passes_node]), np.stack([T.translation for T in T_passes_node])
    return SubmapFactor(node, submap.passes, submap.shares, R, t, covariance, probability)


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
    graph, maker, known = places.graph, places.maker, KnownPath(path, places.graph)
    assert maker is not None
    # Means measure what lies between them, of which the submap of a single pass has its prior alone.
    noise_sd = maker.hyperparameters.noise_sd / float(np.sqrt(known.n_averaged))
    hyperparameters, nowhere = replace(maker.hyperparameters, noise_sd=noise_sd), list[RigidTransform]()
    asked, tasks = [], []
    for window in path.windows:
        if window.keeps_shape and (submap := known.submap(window, graph, later=later)) is not None:
            about = (submap.survey, submap.node, hyperparameters, maker.noise, maker.length, False)
            expected = expected_beside(window, np.array([submap.best_known]), graph)[submap.best_known]
            arguments = (window, Shared(make_submap, about, len(submap.node)), expected, maker.noise, nowhere)
            asked.append((window, submap))
            tasks.append(Task(f"window {window.node} on a map of several passes", arguments))
    what = f"placing {path.survey.name} on the map of its own {'later' if later else 'earlier'} passes"
    for (window, submap), found in zip(asked, run(compare, tasks, what), strict=True):
        if found:
            candidate = Candidate.beside(submap.best_known, found[0][1], window, graph.center(submap.best_known))
            if (factor := submap_factor(candidate, window.node, submap, graph, path)) is not None:
                yield factor
