# SPDX-License-Identifier: BSD-3-Clause
"""The algorithm: map; then for each strategy let maps vote, prepare, search, refine and weigh; settle, decide."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from magmatch.data.survey import Survey
from magmatch.estimation.posterior import Answer, Hypothesis, answers_of, effective_evidence, posterior_of
from magmatch.estimation.walk import choose_search, is_resolved
from magmatch.field.map import FieldMap
from magmatch.progress import tell
from magmatch.published.register import register as register_published
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.answer import state_answer
from magmatch.registration.decide.decision import NO_POSE, DecisionConfig, Verdict, decide, is_sharp
from magmatch.registration.decide.estimate import Estimate, Pair
from magmatch.registration.decide.support import Support
from magmatch.registration.index.atlas import Atlas, Bases, OneBase
from magmatch.registration.index.map_index import MapIndex, prepare_index
from magmatch.registration.map_strategy import MapStrategy
from magmatch.registration.maps import as_map, map_base, map_of
from magmatch.registration.published_answer import answer_of
from magmatch.registration.result import RegistrationResult, Status
from magmatch.registration.search.candidate import NONE_GIVEN, Given, SearchResult
from magmatch.registration.walk_strategy import WalkStrategy
from magmatch.registration.weigh.bend import DRIFTS, REMEDY, Bend
from magmatch.typing import Scalars

Target = Survey | FieldMap
Base = Target | MapIndex | Atlas
# The base that holds the answer and the target as they were used, and the answer.
Outcome = tuple[FieldMap | MapIndex, Target, RegistrationResult]
# Both have the same steps; what one prepares and finds goes to no other.
Strategy = MapStrategy | WalkStrategy


@dataclass(frozen=True, eq=False, slots=True)
class Weighed:
    """Poses of a pair, refined and weighed; nothing is decided yet."""

    strategy: Strategy  # the one that weighed them, and can state and settle them
    pair: Pair[Any, Any]
    found: SearchResult
    ranked: list[Any]  # hypotheses, pose and model, in any order
    elsewhere: float = -np.inf  # nats: log odds of all answers in other bases together; -inf if there are none

    def answers(self, config: DecisionConfig) -> list[Answer[Any]]:
        """Hypotheses that are one answer at the accuracy asked for."""
        return answers_of(self.ranked, config.tolerance(self.pair.length))

    @property
    def most_effective(self) -> float:
        """The largest evidence of a pose, divided by its residuals' dispersion, nats; -inf if there is none."""
        return max((effective_evidence(one.log_evidence, one.misfit) for one in self.ranked), default=-np.inf)

    def log_odds(self, config: DecisionConfig) -> Scalars:
        """Log odds of each answer over unrelated surveys, nats, after one of -inf."""
        return np.array([-np.inf, *(answer.log_odds for answer in self.answers(config))])


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
    if config.search == "keypoints" and not isinstance(base, Atlas):
        return _by_published_method(base, target, config, seed, clock)
    with clock("prepare"):
        bases: Bases = base if isinstance(base, Atlas) else OneBase(prepare_index(base))
    weighed = dict[Any, Weighed]()
    best: Any = None
    answer = None
    for strategy in strategies(bases.length, target, samples, config, seed, clock):
        with clock("votes"):
            # Another strategy is another look at the map that was most probable; the likelier of both looks counts.
            likely = strategy.likely(bases) if best is None else [best]
        ahead = 0.0 if len(likely) > 1 else None  # as of unrelated surveys
        for number, one in enumerate(likely):
            if len(likely) > 1:
                tell(f"searching {bases.name_of(one)}", number / len(likely))
            with clock("prepare"):
                pair: Any = strategy.pair(bases.load(one), bases.volume, bases.length_of(likely))
            with clock("search"):
                found = SearchResult() if given.is_alone else strategy.search(pair)
            with clock("refine"):
                look = refine_and_weigh(strategy, pair, found, given, ahead)
            if ahead is not None:
                ahead = max(ahead, look.most_effective)
            looks = (look, weighed.get(one, look))
            weighed[one] = max(looks, key=lambda each: each.log_odds(config.decision).max())
        best, answer = decide_among(bases, weighed, config.decision, clock)
        if answer.is_accepted and is_sharp(answer.covariance):
            break
    assert answer is not None  # there is always a strategy
    return bases.load(best), weighed[best].strategy.target, answer


def _by_published_method(
    base: FieldMap | MapIndex, target: Target, config: RegistrationConfig, seed: int, clock: Clock
) -> Outcome:
    """Give the answer of the published method, which has its own steps."""
    with clock("maps"):
        target_map = as_map(target, config.field)
    with clock("search"):
        published = register_published(map_of(base), target_map, config=config.keypoints, seed=seed)
    return base, target_map, answer_of(published)


def strategies(
    length: float, target: Target, samples: Survey, config: RegistrationConfig, seed: int, clock: Clock
) -> Iterator[Strategy]:
    """Compare as a walk if samples are a line, short in the base's correlation lengths; otherwise, or next, as a map.

    A path that turns and crosses itself may cover an area, so it is tried as a map first. A map blends what drifted
    apart, so next the path is compared as a walk. The target is mapped only when that strategy is used.
    """
    search = choose_search(samples, length) if config.search == "auto" else config.search
    walk = WalkStrategy(target, samples, config, seed)
    if search == "pairs":
        yield walk
    if config.search != "pairs":
        yield MapStrategy.of(target, config, seed, clock)
    if config.search == "auto" and search != "pairs" and is_resolved(samples, length):
        yield walk


def refine_and_weigh(
    strategy: Strategy, pair: Any, found: SearchResult, given: Given = NONE_GIVEN, ahead: float | None = None
) -> Weighed:
    """Weigh what a search found, and by the same steps what was given: the posterior compares them all.

    ``ahead``: of many maps, evidence of the best pose in those before, nats.
    """
    ranked: list[Any] = list(strategy.refine_and_weigh(pair, found, ahead))
    if given.poses:
        others = given.between(pair.T_base_model, pair.T_target_model)
        ranked += strategy.refine_and_weigh(pair, others)
    return Weighed(strategy, pair, found, ranked)


def decide_among(
    bases: Bases, weighed: dict[Any, Weighed], config: DecisionConfig, clock: Clock
) -> tuple[Any, RegistrationResult]:
    """Decide on the best pose of all maps; a refusal shows the best pose in each other map, too."""
    odds = {one: found.log_odds(config) for one, found in weighed.items()}
    total = {one: np.logaddexp.reduce(z) for one, z in odds.items()}
    best, *others = sorted(weighed, key=lambda one: -odds[one].max())

    def answer_in(one: Any) -> RegistrationResult:
        elsewhere = np.logaddexp.reduce([total[other] for other in total if other is not one], initial=-np.inf)
        return settle_and_decide(replace(weighed[one], elsewhere=float(elsewhere)), config, clock)

    answer = answer_in(best)
    if answer.is_accepted:
        return best, replace(answer, base=bases.name_of(best))
    rest = [(bases.name_of(one), answer_in(one).alternatives[:1]) for one in others]
    elsewhere = tuple(replace(alternative, base=name) for name, found in rest for alternative in found)
    name = bases.name_of(best) if answer.alternatives else None
    return best, replace(answer, base=name, alternatives=answer.alternatives + elsewhere)


def settle_and_decide(weighed: Weighed, config: DecisionConfig, clock: Clock) -> RegistrationResult:
    """Let the best pose's target bend, compare probabilities, settle the best answer's covariance, and decide."""
    pair, found, by = weighed.pair, weighed.found, weighed.strategy
    answers = weighed.answers(config)
    if not answers:
        return RegistrationResult(NO_POSE.status, NO_POSE.reason, None, n_keypoints=found.n_keypoints)
    with clock("settle"):
        best, *others = sorted(answers, key=lambda answer: -answer.log_odds)
        # Of two places, whatever both bend by says nothing.
        best, bent = _that_bend(by, pair, best) if best.effective > 0 else (best, None)
        posterior = posterior_of([best, *others], config.prior_odds, weighed.elsewhere)
        is_probable = posterior.best >= config.min_probability
        estimate, support = _state(by.settle if is_probable else by.state, pair, posterior.answers[0], bent, config)
    with clock("decide"):
        verdict = decide(posterior, estimate, pair.length, config)
        verdict = _naming_drift(verdict, pair, posterior.poses[0], bent, config)
        poses = [pair.estimate(pose).T_base_target for pose in posterior.poses]
        answer = state_answer(verdict, posterior, poses, estimate, support, config.max_sd(pair.length))
        return replace(answer, n_keypoints=found.n_keypoints, n_correspondences=found.n_correspondences)


class _Bent(NamedTuple):
    """The hypothesis of a target that bends, and how."""

    pose: Hypothesis
    bend: Bend


def _naming_drift(
    verdict: Verdict, pair: Pair[Any, Any], best: Any, bent: _Bent | None, config: DecisionConfig
) -> Verdict:
    """Name the drift that the halves of the target show, or but for which its pose would be known well enough."""
    drift = ""
    if bent is not None and best is bent.pose and bent.bend.probability >= config.min_probability:
        drift = str(bent.bend)
    elif verdict.status is Status.DEGENERATE and best.drift is not None:
        undrifted = pair.estimate(replace(best, covariance=best.covariance - best.drift))
        if not undrifted.free_directions(config.max_sd(pair.length)):
            drift = f"{DRIFTS}, {best.model.removeprefix('drifts ')}; {REMEDY}"
    # What drift leaves uncertain is no fault of where was surveyed.
    parts = (verdict.reason, drift) if verdict.status is Status.ACCEPTED else (drift, verdict.reason)
    return replace(verdict, reason="; ".join(filter(None, parts)))


def _that_bend(by: Strategy, pair: Any, answer: Answer[Any]) -> tuple[Answer[Any], _Bent | None]:
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
