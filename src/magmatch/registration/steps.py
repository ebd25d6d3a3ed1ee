# SPDX-License-Identifier: BSD-3-Clause
"""The algorithm: map; then for each strategy let maps vote, prepare, search, refine and weigh; settle, decide."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from magmatch.data.survey import Survey
from magmatch.estimation.hypothesis import Hypothesis
from magmatch.estimation.posterior import Answer, posterior_of
from magmatch.field.map import FieldMap
from magmatch.progress import tell
from magmatch.published.register import register as register_published
from magmatch.registration.bases import Bases, OneBase
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.answer import state_answer
from magmatch.registration.decide.decision import NO_POSE, DecisionConfig, decide
from magmatch.registration.decide.estimate import Estimate
from magmatch.registration.decide.support import Support
from magmatch.registration.index.atlas import Atlas
from magmatch.registration.index.map_index import MapIndex, prepare_index
from magmatch.registration.maps import as_map, map_base, map_of
from magmatch.registration.published_answer import answer_of
from magmatch.registration.result import RegistrationResult, Status
from magmatch.registration.search.candidate import NONE_GIVEN, Given, SearchResult
from magmatch.registration.strategies import strategies
from magmatch.registration.strategy import Among, Pair, Strategy, Weighed
from magmatch.registration.weigh.bend import Bend

Target = Survey | FieldMap
Base = Target | MapIndex | Atlas
# The base that holds the answer and the target as they were used, and the answer.
Outcome = tuple[FieldMap | MapIndex, Target, RegistrationResult]


def register_once(
    base: Base,
    target: Target,
    samples: Survey,
    config: RegistrationConfig,
    seed: int,
    clock: Clock,
    given: Given = NONE_GIVEN,
) -> Outcome:
    """The answer without calibration of sensors; a walk is compared with all its samples, mapped or not."""
    with clock("maps"):
        base, target = map_base(base, target, config.field)
    # The published method has its own steps.
    if config.search == "keypoints" and not isinstance(base, Atlas):
        with clock("maps"):
            target_map = as_map(target, config.field)
        with clock("search"):
            published = register_published(map_of(base), target_map, config=config.keypoints, seed=seed)
        return base, target_map, answer_of(published)
    with clock("prepare"):
        bases: Bases = base if isinstance(base, Atlas) else OneBase(prepare_index(base, config), config)
    weighed = dict[Any, Weighed[Any, Any, Any]]()
    best, answer = None, None
    for strategy in strategies(bases.length, target, samples, config, seed, clock):
        # Another strategy is another look at the map that was most probable; the likelier of both looks counts.
        likely = _likely(bases, strategy, clock) if best is None else [best]
        for one in likely:
            look = weigh(bases, one, likely, strategy, given, clock)
            weighed[one] = max(
                look, weighed.get(one, look), key=lambda each: each.best_log_odds(bases.config.decision)
            )
        best, answer = decide_among(bases, weighed, clock)
        if answer.is_accepted:
            break
    assert answer is not None  # there is always a strategy
    return bases.load(best), weighed[best].strategy.target, answer


def _likely(bases: Bases, strategy: Strategy[Any, Any, Any], clock: Clock) -> list[Any]:
    with clock("votes"):
        return strategy.likely(bases)


def weigh(
    bases: Bases,
    one: Any,
    likely: list[Any],
    strategy: Strategy[Any, Any, Any],
    given: Given,
    clock: Clock,
) -> Weighed[Any, Any, Any]:
    """Weigh poses of the target in one of the maps, with the search penalty for all of them."""
    if len(likely) > 1:
        tell(f"searching {bases.name_of(one)}", likely.index(one) / len(likely))
    with clock("prepare"):
        pair = strategy.pair(bases.load(one), Among(bases.volume, bases.length_of(likely)))
    with clock("search"):
        found = SearchResult() if given.is_alone else strategy.search(pair)
    with clock("refine"):
        return refine_and_weigh(strategy, pair, found, given)


def refine_and_weigh(
    strategy: Strategy[Any, Any, Any], pair: Pair[Any, Any], found: SearchResult, given: Given
) -> Weighed[Any, Any, Any]:
    """Weigh what a search found, and by the same steps what was given: the posterior compares them all."""
    weighed = strategy.refine_and_weigh(pair, found)
    if not given.poses:
        return weighed
    others = strategy.refine_and_weigh(pair, given.between(pair.T_base_model, pair.T_target_model))
    return (
        replace(weighed, ranked=[*weighed.ranked, *others.ranked]) if weighed.ranked else replace(others, found=found)
    )


def decide_among(
    bases: Bases, weighed: dict[Any, Weighed[Any, Any, Any]], clock: Clock
) -> tuple[Any, RegistrationResult]:
    """Decide on the best pose of all maps; a refusal shows the best pose in each other map, too."""
    odds = {one: found.best_log_odds(bases.config.decision) for one, found in weighed.items()}
    best, *others = sorted(weighed, key=lambda one: -odds[one])

    def answer_in(one: Any) -> RegistrationResult:
        elsewhere = max((odds[other] for other in odds if other is not one), default=-np.inf)
        return settle_and_decide(replace(weighed[one], elsewhere=elsewhere), bases.config.decision, clock)

    answer = answer_in(best)
    if answer.is_accepted:
        return best, replace(answer, base=bases.name_of(best))
    rest = [(bases.name_of(one), answer_in(one).alternatives[:1]) for one in others]
    elsewhere = tuple(replace(alternative, base=name) for name, found in rest for alternative in found)
    name = bases.name_of(best) if answer.alternatives else None
    return best, replace(answer, base=name, alternatives=answer.alternatives + elsewhere)


def settle_and_decide(weighed: Weighed[Any, Any, Any], config: DecisionConfig, clock: Clock) -> RegistrationResult:
    """Let the best pose's target bend, compare probabilities, settle the best answer's covariance, and decide."""
    pair, found, by = weighed.pair, weighed.found, weighed.strategy
    answers = weighed.answers(config)
    if not answers:
        return RegistrationResult(NO_POSE.status, NO_POSE.reason, None, n_keypoints=found.n_keypoints)
    with clock("settle"):
        best, *others = sorted(answers, key=lambda answer: -answer.log_odds)
        best, bent = _that_bend(by, pair, best)
        posterior = posterior_of([best, *others], config.prior_odds, weighed.elsewhere)
        is_probable = posterior.best >= config.min_probability
        estimate, support = _state(by.settle if is_probable else by.state, pair, posterior.answers[0], bent, config)
    with clock("decide"):
        verdict = decide(posterior, estimate, pair.length, config)
        is_bent = bent is not None and posterior.poses[0] is bent.pose and posterior.answers[0].effective > 0
        if bent is not None and is_bent and bent.bend.probability >= config.min_probability:
            parts = (verdict.reason, str(bent.bend))
            # What drift leaves uncertain is no fault of where was surveyed.
            verdict = replace(verdict, reason="; ".join(parts[:: 1 if verdict.status is Status.ACCEPTED else -1]))
        poses = [pair.estimate(pose).T_base_target for pose in posterior.poses]
        answer = state_answer(verdict, posterior, poses, estimate, support, config.max_sd(pair.length))
        return replace(answer, n_keypoints=found.n_keypoints, n_correspondences=found.n_correspondences)


class _Bent(NamedTuple):
    """The hypothesis of a target that bends, and how."""

    pose: Hypothesis
    bend: Bend


def _that_bend(
    by: Strategy[Any, Any, Any], pair: Pair[Any, Any], answer: Answer[Any]
) -> tuple[Answer[Any], _Bent | None]:
    """Join the model of a target that bends to an answer."""
    for pose in answer.hypotheses:
        if (bend := by.bend(pair, pose)) is not None:
            rigid, bent = bend.among(pose)
            others = (one for one in answer.hypotheses if one is not pose)
            return Answer.of([*others, rigid, bent]), _Bent(bent, bend)
    return answer, None


def _state(
    state: Callable[[Pair[Any, Any], Any], tuple[Estimate, Support]],
    pair: Pair[Any, Any],
    answer: Answer[Any],
    bent: _Bent | None,
    config: DecisionConfig,
) -> tuple[Estimate, Support]:
    """State the most probable hypothesis of an answer, with the moments of all that are not improbable."""
    shares, estimates, supports = list[float](), list[Estimate](), list[Support]()
    for pose, share in zip(answer.hypotheses, answer.shares, strict=True):
        if shares and share <= 1 - config.min_probability:
            break
        estimate, support = state(pair, pose)
        if bent is not None and pose is bent.pose:
            estimate = estimate.with_spread(bent.bend.seen_from(pair.T_target_model).spread(estimate.center))
        shares.append(share)
        estimates.append(estimate)
        supports.append(support)
    return Estimate.mixture(estimates, shares), supports[0]
