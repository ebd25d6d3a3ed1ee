# SPDX-License-Identifier: BSD-3-Clause
"""Whether a walk drifts: each half fits the base, but not with the same pose."""

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.folds import has_path_order
from magmatch.geometry import transform_error
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.posterior import effective_evidence, needed_evidence
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.map_strategy import MapStrategy
from magmatch.registration.prepared.walk import Walk
from magmatch.registration.result import Alternative, RegistrationResult, Status
from magmatch.registration.walk_strategy import WalkStrategy
from magmatch.registration.weigh.bend import DRIFTS, REMEDY, weigh_halves
from magmatch.registration.weigh.refine_and_weigh_walk import LineEvidence, weigh_walk


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
    strategy = WalkStrategy(samples, samples, config, 0, partial(MapStrategy.of, samples, config, 0, Clock()))
    pair = strategy.pair(index)
    walks, walk, best = pair.base, pair.target, pair.T_base_model.inv() * answer.best_pose * pair.T_target_model

    def weighed(part: Walk, starts: list[RigidTransform]) -> list[LineEvidence]:
        return weigh_walk(walks.base, part, starts, walks.noise, walks.length, pair.prior, config.walks.evidence)[:1]

    def searched(half: Walk) -> list[LineEvidence]:
        found = strategy.search(replace(pair, target=half))
        return weighed(half, [best, *found.poses])

    halves = [one for _, one in weigh_halves(walk, np.arange(len(walk)), searched)]
    evidence = np.array([effective_evidence(one.log_evidence, one.misfit) for one in halves])
    whole = [effective_evidence(one.log_evidence, one.misfit) for one in weighed(walk, [best])]
    # A half without evidence for any pose counts as unrelated.
    excess = evidence.clip(0).sum() - max([0.0, *whole, answer.evidence.get("effective") or 0.0])
    needed = needed_evidence(config.decision.min_probability, "walk", config.decision.prior_odds)
    if len(halves) < 2 or excess < needed:
        return answer
    if evidence.min() >= needed:
        (first, second), meet = halves, walk.positions[len(walk) // 2]
        apart, turn = transform_error(second.T_base_target, first.T_base_target, meet)
        found = f"its halves fit poses {apart:.1f} m and {np.degrees(turn):.0f} deg apart where they meet"
    else:
        better = halves[int(evidence.argmax())]
        apart, turn = transform_error(best, better.T_base_target, better.center)
        max_apart, max_turn = config.decision.tolerance(pair.length)
        if not answer.is_accepted or (apart <= max_apart and turn <= max_turn):
            return answer
        found = f"one half alone fits a pose {apart:.1f} m and {np.degrees(turn):.0f} deg from that of the whole"
    words = f"{DRIFTS}: {found}; {REMEDY}"
    if not answer.is_accepted:
        return replace(answer, reason=f"{words}; as one rigid piece, {answer.reason}")
    probability = (answer.probability or 0.0) / (1 + np.exp(excess))
    return replace(
        answer,
        status=Status.INCONSISTENT,
        reason=words,
        T_base_target=None,
        covariance=None,
        probability=float(probability),
        alternatives=(Alternative(answer.best_pose, float(probability)), *answer.alternatives),
    )
