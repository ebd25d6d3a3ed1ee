# SPDX-License-Identifier: BSD-3-Clause
"""Which maps may hold a target: a few hypotheses in each, and how well they agree.

For a walk, pairs of points propose poses, and those that agree with each other are votes: in the right map many pairs
propose one and the same pose, in any other map each proposes its own. Votes need the maps' pair tables only, so
maps are asked without reading their fields, and of thousands only those that hold pairs like the walk's. Other
targets score a few poses against each map's field.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from magmatch.compiled import compiled
from magmatch.data.survey import Survey
from magmatch.estimation.candidate_poses import OUTLIER_SHARE, pose_inaccuracy, same_pose
from magmatch.estimation.limits import (
    MAX_ASKED,
    N_CANDIDATES,
    N_JUDGES,
    N_REFINED,
    SHARED_LENGTH,
    VOTING_ANCHORS,
    VOTING_PAIRS,
)
from magmatch.estimation.walk import Walk, walk_of
from magmatch.registration.prepared.prepared_map import PreparedMap, common_length
from magmatch.registration.search.invariant_search import (
    choose_anchors,
    frame_poses,
    judging_samples,
    similar_points,
)
from magmatch.registration.search.pair_search import (
    PairSearchConfig,
    PairTable,
    choose_pairs,
    invariants_of,
    pair_poses,
)
from magmatch.registration.search.scoring import score_poses, weigh_samples
from magmatch.typing import Indices, Matrix, Scalars

# Maps with this share of the most votes are searched in full, too.
SHORTLIST_SHARE = 0.5
# Poses nearer than this are one, in the base's correlation lengths at the walk's centre.
SAME_PLACE = 0.65
# Squared distance (in standard deviations) of a pair's invariants at which its vote is worth 1/e.
DISTANCE2 = 8.0


def shortlist(votes: Scalars) -> list[int]:
    """Maps for a full search, most likely first: always a few, and those nearly as likely as the first."""
    order = np.argsort(-votes, kind="stable")[:N_CANDIDATES].tolist()
    enough = SHORTLIST_SHARE * votes[order[0]]
    return [k for n, k in enumerate(order) if n < N_REFINED or votes[k] >= enough]


def count_votes(tables: list[PairTable], target: Survey, config: PairSearchConfig, seed: int) -> Scalars:
    """Share of a walk's pairs that agree on one pose, in the maps that hold pairs most like them; 0 elsewhere."""
    few = config.model_copy(update=dict(zip(("n_pairs", "n_neighbours"), VOTING_PAIRS, strict=True)))
    asked: dict[int, Question] = {}
    questions = []
    for table in tables:
        step = round(float(np.log(table.length) / np.log(SHARED_LENGTH)))
        if step not in asked:
            walk = walk_of(target, SHARED_LENGTH**step)
            asked[step] = Question.of(walk, table, few, np.random.default_rng(seed))
        questions.append(asked[step])
    votes = np.zeros(len(tables))
    alike = np.array([one.likeness(table) for one, table in zip(questions, tables, strict=True)])
    for k in np.argsort(-alike, kind="stable")[:MAX_ASKED]:
        votes[k] = questions[k].votes(tables[k], few.n_neighbours)
    return votes


class Question(NamedTuple):
    """The pairs of a walk's bins, and their invariants, that are looked up in tables of one scale."""

    walk: Walk
    first: Indices
    second: Indices
    invariants: Matrix

    @classmethod
    def of(cls, walk: Walk, table: PairTable, config: PairSearchConfig, rng: np.random.Generator) -> "Question":
        """Draw pairs that suit a table."""
        i, j = choose_pairs(walk, table, config, rng)
        return cls(walk, i, j, invariants_of(walk, i, j))

    def likeness(self, table: PairTable) -> float:
        """How much pairs near the walk's in a table's tree weigh: what costs a hundredth of a vote, and bounds it."""
        if not len(self.first) or not len(table.first):
            return 0.0
        _, distance2 = table.nearest(self.invariants, 1, n_leaves=1)
        return float(_weights(distance2).mean())

    def votes(self, table: PairTable, n_neighbours: int) -> float:
        """Share of the pairs that agree on the pose most of them agree on."""
        if not len(self.first) or not len(table.first):
            return 0.0
        similar, distance2 = table.nearest(self.invariants, n_neighbours)
        poses = pair_poses(table, self.walk, self.first, self.second, similar)
        centers = poses.carry(self.walk.positions.mean(axis=0))
        weights, angle, distance = _weights(distance2).ravel(), same_pose(table.length)[0], SAME_PLACE * table.length
        largest = _largest_agreement(poses.rotations, centers, poses.anchor_rows, weights, angle, distance)
        return float(largest / len(self.first))


def _weights(distance2: Matrix) -> Matrix:
    """Pairs unlike any of the base fall to its most unlike ones, all in one place: such agreement means little."""
    return np.asarray(np.exp(-distance2 / DISTANCE2))


def count_agreement(bases: Iterable[PreparedMap], target: PreparedMap, seed: int) -> Scalars:
    """Score of the best of a few poses of a target, in each of many maps."""
    return np.array([_best_score(base, target, np.random.default_rng(seed)) for base in bases])


def _best_score(base: PreparedMap, target: PreparedMap, rng: np.random.Generator) -> float:
    n_anchors, n_neighbours = VOTING_ANCHORS
    anchors = choose_anchors(target, n_anchors, rng)
    neighbours = similar_points(base, target, anchors, n_neighbours)
    poses = frame_poses(base, target, anchors, neighbours)
    judges = judging_samples(poses.anchors_target, target, N_JUDGES, rng)
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
