# SPDX-License-Identifier: BSD-3-Clause
"""Which maps may hold a target: a few hypotheses in each, and how well they agree.

For a walk, pairs of points propose poses, and those that agree with each other are votes: in the right map many pairs
propose one and the same pose, in any other map each proposes its own. Votes need the maps' pair tables only, so
maps are asked without reading their fields, and of thousands only those that hold pairs like the walk's. Other
targets score a few poses against each map's field. Either way a map is asked with a part of what a search tries.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from magmatch.compiled import compiled
from magmatch.data.survey import Survey
from magmatch.estimation.candidate_poses import OUTLIER_SHARE, pose_inaccuracy, same_pose
from magmatch.estimation.limits import (
    COARSER,
    FEW_POINTS,
    MAX_ASKED,
    N_ANCHORS,
    N_CANDIDATES,
    N_LIKE_PAIRS,
    N_NEIGHBOURS,
    N_REFINED,
    RARER,
)
from magmatch.estimation.walk import Walk, walk_of
from magmatch.registration.prepared.prepared_map import PreparedMap, common_length
from magmatch.registration.search.invariant_search import choose_anchors, frame_poses, judging_samples, similar_points
from magmatch.registration.search.pair_search import PairTable, choose_pairs, invariants_of, pair_poses
from magmatch.registration.search.scoring import score_poses, weigh_samples
from magmatch.typing import Indices, Matrix, Scalars


def shortlist(votes: Scalars) -> list[int]:
    """Maps for a full search, most likely first: always a few, and those nearly as likely as the first."""
    order = np.argsort(-votes, kind="stable")[:N_CANDIDATES].tolist()
    # A map with so many times fewer votes is not worth a search.
    enough = votes[order[0]] / RARER
    return [k for n, k in enumerate(order) if n < N_REFINED or votes[k] >= enough]


def count_votes(tables: list[PairTable], target: Survey, seed: int) -> Scalars:
    """Share of a walk's pairs that agree on one pose, in the maps that hold pairs most like them; 0 elsewhere."""
    asked: dict[int, Question] = {}
    questions = []
    for table in tables:
        # Maps whose correlation lengths differ by less than a factor share one binning of the walk.
        step = round(float(np.log(table.length) / np.log(COARSER)))
        if step not in asked:
            walk = walk_of(target, COARSER**step)
            asked[step] = Question.of(walk, table, np.random.default_rng(seed))
        questions.append(asked[step])
    votes = np.zeros(len(tables))
    alike = np.array([one.likeness(table) for one, table in zip(questions, tables, strict=True)])
    for k in np.argsort(-alike, kind="stable")[:MAX_ASKED]:
        votes[k] = questions[k].votes(tables[k])
    return votes


class Question(NamedTuple):
    """The pairs of a walk's bins, and their invariants, that are looked up in tables of one scale."""

    walk: Walk
    first: Indices
    second: Indices
    invariants: Matrix

    @classmethod
    def of(cls, walk: Walk, table: PairTable, rng: np.random.Generator) -> "Question":
        """Draw pairs that suit a table."""
        i, j = choose_pairs(walk, table, FEW_POINTS // RARER, rng)
        return cls(walk, i, j, invariants_of(walk, i, j))

    def likeness(self, table: PairTable) -> float:
        """How much pairs near the walk's in a table's tree weigh: what costs a hundredth of a vote, and bounds it."""
        if not len(self.first) or not len(table.first):
            return 0.0
        _, distance2 = table.nearest(self.invariants, 1, n_leaves=1)
        return float(_weights(distance2, self.invariants).mean())

    def votes(self, table: PairTable) -> float:
        """Share of the pairs that agree on the pose most of them agree on."""
        if not len(self.first) or not len(table.first):
            return 0.0
        similar, distance2 = table.nearest(self.invariants, N_LIKE_PAIRS // RARER)
        poses = pair_poses(table, self.walk, self.first, self.second, similar)
        centers = poses.carry(self.walk.positions.mean(axis=0))
        weights = _weights(distance2, self.invariants).ravel()
        largest = _largest_agreement(poses.rotations, centers, poses.anchor_rows, weights, *same_pose(table.length))
        return float(largest / len(self.first))


def _weights(distance2: Matrix, invariants: Matrix) -> Matrix:
    """Votes by squared distances in standard deviations: 1/e where right pairs are, one for each invariant.

    Pairs unlike any of the base fall to its most unlike ones, all in one place: such agreement means little.
    """
    return np.asarray(np.exp(-distance2 / invariants.shape[1]))


def count_agreement(bases: Iterable[PreparedMap], target: PreparedMap, seed: int) -> Scalars:
    """Score of the best of a few poses of a target, in each of many maps."""
    return np.array([_best_score(base, target, np.random.default_rng(seed)) for base in bases])


def _best_score(base: PreparedMap, target: PreparedMap, rng: np.random.Generator) -> float:
    anchors = choose_anchors(target, N_ANCHORS // RARER, rng)
    neighbours = similar_points(base, target, anchors, N_NEIGHBOURS // RARER)
    poses = frame_poses(base, target, anchors, neighbours)
    judges = judging_samples(poses.anchors_target, target, FEW_POINTS, rng)
    sd = pose_inaccuracy(common_length(base, target))
    scores = score_poses(poses, judges, weigh_samples(base, target), base, *sd, OUTLIER_SHARE)
    return max(float(scores.max()), 0.0)


@compiled
def _largest_agreement(R, centers, pair_rows, weights, angle, distance):  # type: ignore[no-untyped-def]
    """Largest weight of poses around one of the poses, each pair counted once; poses of a pair stand together."""
    least_trace, best = 1.0 + 2.0 * np.cos(angle), 0.0
    for h in range(len(R)):
        total, own = 0.0, 0.0
        for g in range(len(R)):
            if g > 0 and pair_rows[g] != pair_rows[g - 1]:
                total, own = total + own, 0.0
            d2, trace = 0.0, 0.0
            for c in range(3):
                d2 += (centers[h, c] - centers[g, c]) ** 2
            if d2 > distance * distance or weights[g] <= own:
                continue
            for a in range(3):
                for b in range(3):
                    trace += R[h, a, b] * R[g, a, b]
            if trace > least_trace:
                own = weights[g]
        best = max(best, total + own)
    return best
