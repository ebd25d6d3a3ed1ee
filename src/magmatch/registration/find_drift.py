# SPDX-License-Identifier: BSD-3-Clause
"""Whether a walk drifts: each half fits the base, but not with the same pose."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.folds import has_path_order
from magmatch.geometry import is_one_pose, transform_error
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.posterior import effective_evidence, needed_evidence
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.prepared.walk import Walk
from magmatch.registration.result import Alternative, RegistrationResult, Status
from magmatch.registration.walk_strategy import WalkPair, WalkStrategy
from magmatch.registration.weigh.bend import DRIFTS, REMEDY, weigh_halves
from magmatch.registration.weigh.refine_and_weigh_walk import LineEvidence, weigh_walk
from magmatch.typing import Vector3


def naming_drift(
    answer: RegistrationResult, index: MapIndex, samples: Survey, config: RegistrationConfig
) -> RegistrationResult:
    """A refusal whose reason names drift first, if the halves of a path have different poses.

    Together the halves must exceed the evidence of a single pose by as much as an answer needs. The evidence of two
    poses includes two search penalties, so the excess shows that they differ. An answer that is accepted only beside
    a change of the field is refused then, also if one half alone is found, elsewhere: drift explains the residuals
    better. Of a refusal drift is named if each half has the evidence of an answer.
    """
    is_explained = answer.is_accepted and answer.evidence.get("unchanged", 1.0) == 1.0
    if is_explained or DRIFTS in answer.reason or answer.best_pose is None or config.search not in ("auto", "pairs"):
        return answer
    if not has_path_order(samples.positions):
        return answer
    strategy = WalkStrategy(samples, samples, config, 0)
    pair = strategy.pair(index)
    best = pair.T_base_model.inv() * answer.best_pose * pair.T_target_model
    halves, whole = _weigh_in_halves(strategy, pair, best)
    evidence = np.array([effective_evidence(one.log_evidence, one.misfit) for one in halves])
    # A half without evidence for any pose counts as unrelated.
    excess = evidence.clip(0).sum() - max(0.0, whole, answer.evidence.get("effective") or 0.0)
    needed = needed_evidence(config.decision.min_probability, "walk", config.decision.prior_odds)
    if len(halves) < 2 or excess < needed:
        return answer
    better, same = halves[int(evidence.argmax())], config.decision.tolerance(pair.length)
    if evidence.min() >= needed:
        found = _apart(halves[0], halves[1], pair.target.positions[len(pair.target) // 2])
    elif answer.is_accepted and not is_one_pose(best, better.T_base_target, better.center, same):
        found = _away(better, best)
    else:
        return answer
    words = f"{DRIFTS}: {found}; {REMEDY}"
    if not answer.is_accepted:
        return replace(answer, reason=f"{words}; as one rigid piece, {answer.reason}")
    return _refused(answer, answer.best_pose, words, float((answer.probability or 0.0) / (1 + np.exp(excess))))


def _weigh_in_halves(
    strategy: WalkStrategy, pair: WalkPair, best: RigidTransform
) -> tuple[list[LineEvidence], float]:
    """The best pose of each half that has one, and the effective evidence of the whole at its own (nats)."""
    walks, config = pair.base, strategy.config.walks.evidence

    def weighed(part: Walk, starts: Sequence[RigidTransform]) -> list[LineEvidence]:
        return weigh_walk(walks.base, part, starts, walks.noise, walks.length, pair.prior, config)[:1]

    def searched(half: Walk) -> list[LineEvidence]:
        return weighed(half, [best, *strategy.search(replace(pair, target=half)).poses])

    halves = [one for _, one in weigh_halves(pair.target, np.arange(len(pair.target)), searched)]
    whole = [effective_evidence(one.log_evidence, one.misfit) for one in weighed(pair.target, [best])]
    return halves, max(whole, default=-np.inf)


def _apart(first: LineEvidence, second: LineEvidence, meet: Vector3) -> str:
    apart, turn = transform_error(second.T_base_target, first.T_base_target, meet)
    return f"its halves fit poses {apart:.1f} m and {np.degrees(turn):.0f} deg apart where they meet"


def _away(half: LineEvidence, whole: RigidTransform) -> str:
    away, turn = transform_error(whole, half.T_base_target, half.center)
    return f"one half alone fits a pose {away:.1f} m and {np.degrees(turn):.0f} deg from that of the whole"


def _refused(answer: RegistrationResult, pose: RigidTransform, reason: str, probability: float) -> RegistrationResult:
    """The answer without its pose, which becomes the first alternative."""
    return replace(
        answer,
        status=Status.INCONSISTENT,
        reason=reason,
        T_base_target=None,
        covariance=None,
        probability=probability,
        alternatives=(Alternative(pose, probability), *answer.alternatives),
    )
