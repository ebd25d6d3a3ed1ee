# SPDX-License-Identifier: BSD-3-Clause
"""Loop closure of a window with earlier path: registration's search and evidence, with the graph as prior."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.candidate_poses import pose_inaccuracy
from magmatch.estimation.path_noise import PathNoise, Stretch
from magmatch.estimation.pose_prior import PosePrior, PosePriorConfig, pose_prior
from magmatch.estimation.posterior import distinct, log_odds
from magmatch.estimation.walk_null_model import UnrelatedWalk
from magmatch.field.values import gradient_of
from magmatch.geometry import adjoint, product, rotation_matrix, transform_of, turn_and_shift
from magmatch.preparation.odometry.drift import LEVEL_SD, UPRIGHT_SD
from magmatch.registration.search.pair_search import pair_search
from magmatch.registration.weigh.refine_and_weigh_walk import inside_base, weigh_walk
from magmatch.slam.config import MOST_ODDS
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.search.submaps import Submap, volume_of
from magmatch.slam.windows import Window
from magmatch.threads import single_threaded
from magmatch.typing import Covariance6, Indices, Scalars

# Poses nearer than this are one answer: in field lengths, and rad.
SAME_SHIFT, SAME_TURN = 0.3, 0.1
# Standard deviations within which a predicted pose is looked for: farther off, the prediction costs more than a
# closure may gain. Drift is learned for all logs together; on single stretches it is larger.
REACH = float(np.sqrt(2 * MOST_ODDS))
# Covariance of a node about where the graph has it, whatever that says: gravity and one floor hold it no better.
NODE_COVARIANCE = np.diag(np.repeat([UPRIGHT_SD, LEVEL_SD], 3) ** 2)


@dataclass(frozen=True, eq=False, slots=True)
class Rough:
    """The pose that the graph predicts for a window."""

    T_base_log: RigidTransform
    covariance: Covariance6  # (6, 6): of xi in ``T Exp(xi)`` about the window's node, log's axes

    @property
    def largest_sds(self) -> Scalars:
        """Standard deviations of rotation (rad) and position (m), in the direction least known; (2,)."""
        C = self.covariance + NODE_COVARIANCE
        return np.sqrt([np.linalg.eigvalsh(C[k : k + 3, k : k + 3])[-1] for k in (0, 3)])

    def is_narrow(self, length: float) -> bool:
        """Whether it is known as well as poses are told apart, so that to refine it is enough."""
        turn, shift = self.largest_sds
        return bool(turn < SAME_TURN and shift < SAME_SHIFT * length)

    def prior(self, window: Window, base: Submap) -> PosePrior:
        """Prior of the pose between model frames."""
        M = adjoint(window.T_middle_node)
        C = M @ (self.covariance + NODE_COVARIANCE) @ M.T
        T = product(base.index.base.T_map_model.inv(), self.T_base_log, window.walk.T_survey_walk)
        return replace(_prior(window, base, volume_of(base)), T_base_target=T, covariance=C, far2=REACH**2)

    def log_densities(self, window: Window, T_base_log: RigidTransform, _: PosePrior) -> tuple[float, float]:
        """Log density of the pose where it is densest, and how much less it is at another.

        Of the components that drift: the others hold for each window by itself.
        """
        C, drifts = self.covariance + NODE_COVARIANCE, window.config.drifts
        densest = float(log_density(RigidTransform.identity(), C, drifts))
        return densest, densest - float(log_density(self.off(window, T_base_log), C, drifts))

    def off(self, window: Window, T_base_log: RigidTransform) -> RigidTransform:
        """Another pose of the window's node as seen from the predicted one, in the axes of the node."""
        return product(window.T_log_node.inv(), self.T_base_log.inv(), T_base_log, window.T_log_node)


@dataclass(frozen=True, eq=False, slots=True)
class Anywhere:
    """No prediction: a window may lie anywhere in all that is searched. It has both methods of `Rough`."""

    volume: float  # m^3: of all that is searched

    def prior(self, window: Window, base: Submap) -> PosePrior:
        """Poses that put the window inside the base are alike probable."""
        prior, index = _prior(window, base, self.volume), base.index
        return inside_base(prior, index.base, window.walk)

    def log_densities(self, window: Window, _: RigidTransform, prior: PosePrior) -> tuple[float, float]:
        """Log density, which is the same everywhere."""
        turns = 2 * np.pi if window.config.is_gravity_aligned else 8 * np.pi**2
        height = prior.height_range if prior.height is not None else 1.0
        return float(np.log(height / (self.volume * turns)) - prior.log_share_inside), 0.0


Expected = Rough | Anywhere


def earlier_passes(window: Window, nodes: Indices, graph: PoseGraph) -> Indices:
    """Select those of some nodes that lie before a window and do not adjoin it."""
    return np.asarray(nodes[(nodes < window.node) & ~graph.is_one_pass(nodes, window.node)])


def is_known(window: Window, nodes: Indices, graph: PoseGraph) -> bool:
    """Whether the graph knows where a window lies beside one of some nodes, as well as poses are told apart."""
    return bool(graph.sds_of_place(nodes, window.node).min() < SAME_SHIFT * window.length)


def nearby(window: Window, nodes: Indices, graph: PoseGraph) -> Indices:
    """Select those of some nodes, on earlier passes, that the graph puts a window near."""
    firsts = earlier_passes(window, nodes, graph)
    if not len(firsts) or not window.keeps_shape:
        return firsts[:0]
    apart = np.linalg.norm(graph.p[firsts] - graph.p[window.node], axis=1)
    beyond = (apart - window.path_length / 2 - window.length) / REACH
    return np.asarray(firsts[beyond <= graph.sds_of_place(firsts, window.node)])


def expected_beside(window: Window, nodes: Indices, graph: PoseGraph) -> dict[int, Rough]:
    """Pose of a window that the graph expects relative to each of some nodes."""
    b, found = window.node, {}
    for a, C in zip(nodes.tolist(), graph.relative_covariances(nodes, b), strict=True):
        R = graph.R[a].T @ graph.R[b]
        at = graph.start[a] + graph.R[a].T @ (graph.p[b] - graph.p[a])
        found[a] = Rough(transform_of(R, at - R @ window.center), C)
    return found


@dataclass(frozen=True, eq=False, slots=True)
class Match:
    """A pose of a window in a submap."""

    T_base_log: RigidTransform  # frame of the base's samples from that of the window's log
    covariance: Covariance6  # (6, 6): of xi in ``T Exp(xi)`` about the window's node, log's axes
    # Over an unrelated field: of the field, by the law of a registration without its offset, less the prior's cost.
    log_odds: float
    # Density of the prior at the pose, per m and rad, of the components that drift.
    log_prior: float
    # Where the field alone puts the window's node, from where field and graph do, and the covariance of that: what
    # the graph predicted is no news to it.
    T_node_alone: RigidTransform
    covariance_alone: Covariance6


def matches(
    window: Window,
    base: Submap,
    expected: Expected,
    known: Sequence[RigidTransform] | None = None,
    nodes: Indices | None = None,
) -> list[Match]:
    """Poses of a window in a submap, most likely first.

    They are refined from poses that are known, where the base was searched before, else from those of a search; and
    from the predicted pose. With some nodes, only from those that lie in their windows.
    """
    index, walk = base.index, window.walk
    prior = expected.prior(window, base)
    T_base, T_walk = index.base.T_map_model, walk.T_survey_walk
    T_model_base, T_walk_log = T_base.inv(), T_walk.inv()
    T_walk_node = product(T_walk_log, window.T_log_node)
    T_node_walk = T_walk_node.inv()
    if known is None:
        proposed = pair_search(index.base, index.table, walk, prior, np.random.default_rng(0))
        starts = list(proposed.poses)
    else:
        starts = [T for T in (product(T_model_base, T, T_walk) for T in known) if _is_expected(T, window, prior)]
    starts += [] if prior.T_base_target is None else [prior.T_base_target]
    if nodes is not None and starts:
        at = np.array([T.apply(T_walk_node.translation) for T in starts])
        is_here = base.are_near(T_base.apply(at), nodes)
        starts = [starts[k] for k in np.flatnonzero(is_here)]
    if not starts:
        return []
    null = _unrelated(window, index.noise, is_predicted=prior.T_base_target is not None)
    weighed = weigh_walk(index.base, walk, starts, index.noise, prior, window.bending, null)
    M = adjoint(window.T_middle_node.inv())
    # Gravity and the floor hold each window by itself.
    predicted = replace(prior, up_base=None, up_target=None, height=None)
    # Poses that the data cannot tell apart are one answer.
    same = SAME_SHIFT * index.length, SAME_TURN
    found = []
    for e in distinct((e for e in weighed if np.isfinite(e.log_evidence)), same):
        T = product(T_base, e.T_base_target, T_walk_log)
        densest, less = expected.log_densities(window, T, prior)
        # The law is that of errors of the field: what the prediction costs counts in full.
        odds = log_odds(e.log_evidence + less, e.misfit, "window") - less
        T_alone, C_alone = predicted.taken_out(e.T_base_target, e.center, e.covariance)
        T_node_alone = product(T_node_walk, e.T_base_target.inv(), T_alone, T_walk_node)
        found.append(Match(T, M @ e.covariance @ M.T, odds, densest - less, T_node_alone, M @ C_alone @ M.T))
    return found


# A comparison finds nodes of the submap, and poses beside them.
Found = list[tuple[int, Match]]


@dataclass(frozen=True, eq=False, slots=True)
class Candidate:
    """A node near which a window may lie, and the relative pose."""

    node: int
    T_node_window: RigidTransform
    match: Match

    @classmethod
    def beside(cls, node: int, match: Match, window: Window, T_submap_node: RigidTransform) -> "Candidate":
        """Make one of a match in a submap, beside a node whose pose there is given."""
        return cls(node, product(T_submap_node.inv(), match.T_base_log, window.T_log_node), match)


@single_threaded
def compare(
    window: Window, submap: Submap, expected: Expected, noise: PathNoise,
    known: Sequence[RigidTransform] | None = None, nodes: Indices | None = None,
) -> Found:  # fmt: skip
    """Poses of a window in a submap, most likely first, each with the node of the submap in whose window it lies.

    ``noise``: of walks, as it is known now; ``known``: poses of an earlier search, which need no other; ``nodes``: in
    whose windows it may lie, if not in all.
    """
    if known is None and isinstance(expected, Rough) and expected.is_narrow(window.length):
        known = []  # what is known well is not searched for
    found = matches(window, submap.with_noise(noise), expected, known, nodes)
    if not found:
        return []
    beside = submap.nodes_near(np.array([match.T_base_log.apply(window.center) for match in found]))
    return list(zip(beside.tolist(), found, strict=True))


def log_density(off: RigidTransform, covariance: np.ndarray, drifts: Indices) -> np.ndarray:
    """Log density of poses that are ``off = Exp(xi)`` from where they are predicted, of the components that drift.

    Gravity and the floor hold each window by itself, so its own evidence has them; a neighbour predicts the others.
    One pose with its covariance (6, 6), or h of them with theirs (h, 6, 6).
    """
    r = turn_and_shift(off)[..., drifts]
    S = covariance[..., drifts[:, None], drifts]
    chi2 = (r * np.linalg.solve(S, r[..., None])[..., 0]).sum(axis=-1)
    return np.asarray(-0.5 * (chi2 + np.linalg.slogdet(2 * np.pi * S)[1]))


@lru_cache(maxsize=1)
def _unrelated(window: Window, noise: PathNoise, *, is_predicted: bool) -> UnrelatedWalk:
    """The null model of a window: kept while one submap after the other is compared with it."""
    return UnrelatedWalk(window.walk, noise, window.length, window.around if is_predicted else None)


def _is_expected(T: RigidTransform, window: Window, prior: PosePrior) -> bool:
    """Whether a pose between model frames is one that a search would have kept."""
    center = window.walk.positions.mean(axis=0)
    inaccuracy = pose_inaccuracy(window.length)
    return bool(prior.admits(rotation_matrix(T)[None], T.apply(center)[None], center, inaccuracy)[0])


def residuals(window: Window, base: Submap, T_base_log: RigidTransform) -> Stretch:
    """Residuals of a window where a submap knows the field: noise is learned from them."""
    prepared, walk = base.index.base, window.walk
    T = prepared.T_map_model.inv() * T_base_log * walk.T_survey_walk
    points = T.apply(walk.positions)
    values = prepared.posterior.evaluate(points, order=1).rotated(T.inv())
    _, sd, _, is_known = prepared.raster.lookup(points)
    rows = np.flatnonzero(is_known)
    G = gradient_of(values)[rows]
    return Stretch(walk.positions[rows], (walk.field - values.field)[rows], sd[rows], G, walk.field[rows])


def _prior(window: Window, base: Submap, volume: float) -> PosePrior:
    """What is known of the pose between model frames without a prediction: gravity, the floor, and a volume (m^3)."""
    config = window.config
    known = PosePriorConfig(
        is_gravity_aligned=config.is_gravity_aligned,
        gravity_sd=UPRIGHT_SD,
        is_planar=config.is_planar and config.is_gravity_aligned,
        height_sd=LEVEL_SD,
    )
    return pose_prior(known, base.index.base.T_map_model, window.walk.T_survey_walk, volume)
