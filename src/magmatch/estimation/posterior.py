# SPDX-License-Identifier: BSD-3-Clause
"""The posterior over poses and models of them, and the hypothesis that the two surveys are unrelated.

Poses within the accuracy asked for are one answer, under whatever models: the probability stated is that a pose is
right to so much.
Evidence assumes that residuals are no larger than expected and that model errors are independent. Residuals larger
than expected amount to fewer independent samples, so evidence is divided by their dispersion, the square of the
misfit (quasi-likelihood: R. Wedderburn, Biometrika 61(3), 1974). Errors common to all samples do not average out, so
log odds grow only with the logarithm of large evidence. In this law,

    log odds = scale * asinh(effective evidence / saturation) - offset,

the numbers are fitted to pairs with known ground truth; they are in ``fitted.json``, which names the script.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Generic, Literal, Protocol, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import is_one_pose
from magmatch.typing import Covariance6, Vector3

Kind = Literal["map", "walk", "log", "window"]


class Hypothesis(Protocol):
    """One pose, refined and weighed against the null model; frames are those of the models compared."""

    @property
    def kind(self) -> Kind:
        """The kind of evidence: from cells of a map, bins along a walk, of a live log, or of a window of a path."""

    @property
    def model(self) -> str:
        """Under which model it was weighed; the poses of one model are rivals, the models of one pose are not."""

    @property
    def T_base_target(self) -> RigidTransform:
        """The pose."""

    @property
    def center(self) -> Vector3:
        """Point of the target about which the covariance is stated, m."""

    @property
    def covariance(self) -> Covariance6 | None:
        """Covariance from the comparison of the fields; None if they do not determine the pose."""

    @property
    def log_evidence(self) -> float:
        """Evidence for this pose against the null model, with the penalty for the search over all poses, nats."""

    @property
    def attainable(self) -> float:
        """The evidence if the base explained the target up to noise, nats."""

    @property
    def misfit(self) -> float:
        """Normalised rms of the residuals: 1 where the noise and the map's spread explain them."""

    @property
    def overlap(self) -> float:
        """Share of the target inside the base map."""


H = TypeVar("H", bound=Hypothesis)


class Fitted(BaseModel):
    """The numbers of the law above."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    scale: float = Field(gt=0)
    saturation: float = Field(gt=0)  # nats: evidence above which it counts logarithmically
    # For each kind of evidence, a correction for what unrelated surveys reach; 0 if nothing was fitted
    offset: dict[Kind, float]

    def log_odds(self, effective: float, kind: Kind) -> float:
        """Log odds over unrelated surveys, at prior odds of one, of effective evidence (nats)."""
        return float(self.scale * np.arcsinh(effective / self.saturation) - self.offset.get(kind, 0.0))

    def effective(self, log_odds: float, kind: Kind) -> float:
        """Effective evidence (nats) that has such log odds."""
        return float(self.saturation * np.sinh((log_odds + self.offset.get(kind, 0.0)) / self.scale))


# A pose is right within this multiple of the largest standard deviation allowed, and models of one pose are one
# answer within it, or within this multiple of what they are known by.
RIGHT_WITHIN = 3.0


@cache
def fitted() -> Fitted:
    """The packaged numbers."""
    return Fitted.model_validate(json.loads(files(__package__).joinpath("fitted.json").read_text(encoding="utf-8")))


@cache
def law_of(kind: Kind) -> Fitted:
    """The law of a kind of evidence; a live log's is calibrated while small: common errors alone are allowed for."""
    numbers = fitted()
    return numbers if kind != "log" else Fitted(scale=numbers.saturation, saturation=numbers.saturation, offset={})


def effective_evidence(log_evidence: float, misfit: float) -> float:
    """Evidence divided by the residuals' dispersion, nats.

    Evidence against a pose is not reduced.
    """
    return log_evidence / max(misfit, 1.0) ** 2 if log_evidence > 0 else log_evidence


def log_odds(log_evidence: float, misfit: float, kind: Kind, numbers: Fitted | None = None) -> float:
    """Log odds of one pose over unrelated surveys, at prior odds of one, nats."""
    effective = effective_evidence(log_evidence, misfit)
    return (numbers or law_of(kind)).log_odds(effective, kind) if np.isfinite(effective) else -np.inf


def needed_evidence(probability: float, kind: Kind, prior_odds: float = 1.0) -> float:
    """Effective evidence that a pose without rivals needs for a given probability, nats."""
    return law_of(kind).effective(float(np.log(probability / (1 - probability)) - np.log(prior_odds)), kind)


@dataclass(frozen=True, eq=False, slots=True)
class Answer(Generic[H]):
    """Hypotheses of poses that are one answer: one pose under several models."""

    hypotheses: tuple[H, ...]  # the most probable first
    effective: float  # nats: evidence of all together, divided by the dispersion of each one's residuals

    @classmethod
    def of(cls, hypotheses: Sequence[H]) -> "Answer[H]":
        """Add up the evidence of models of one pose; at least one hypothesis."""
        ranked = sorted(hypotheses, key=lambda h: -_effective(h))
        return cls(tuple(ranked), float(np.logaddexp.reduce([_effective(h) for h in ranked])))

    @property
    def best(self) -> H:
        """The most probable hypothesis."""
        return self.hypotheses[0]

    @property
    def log_odds(self) -> float:
        """Log odds over unrelated surveys, at prior odds of one, nats."""
        return law_of(self.best.kind).log_odds(self.effective, self.best.kind)

    @property
    def shares(self) -> tuple[float, ...]:
        """The share of each hypothesis in the answer's probability; they sum to one."""
        return tuple(float(np.exp(_effective(h) - self.effective)) for h in self.hypotheses)


@dataclass(frozen=True, eq=False, slots=True)
class Posterior(Generic[H]):
    """Probabilities of mutually exclusive answers and of unrelated surveys; they sum to one."""

    answers: tuple[Answer[H], ...]  # most probable first
    probabilities: tuple[float, ...]  # one per answer
    elsewhere: float  # of all answers in other bases
    null: float  # that base and target are unrelated

    @property
    def poses(self) -> tuple[H, ...]:
        """The most probable hypothesis of each answer."""
        return tuple(answer.best for answer in self.answers)

    @property
    def best(self) -> float:
        """Probability of the most probable answer; 0 if there is none."""
        return self.probabilities[0] if self.probabilities else 0.0

    @property
    def rivals(self) -> float:
        """Probability of all other answers together."""
        return sum(self.probabilities[1:]) + self.elsewhere

    @property
    def lead(self) -> float | None:
        """Log odds of the most probable answer over any other, nats; None if there is no other."""
        rival = max([*self.probabilities[1:], self.elsewhere])
        return float(np.log(self.best / rival)) if rival > 0 and self.best > 0 else None


def posterior_of(answers: Sequence[Answer[H]], prior_odds: float = 1.0, elsewhere: float = -np.inf) -> Posterior[H]:
    """Weigh answers of one target in one base against each other and against unrelated surveys.

    ``prior_odds``: that both surveys cover a common place; ``elsewhere``: log odds of all answers in other bases,
    nats.
    """
    ranked = sorted(answers, key=lambda answer: -answer.log_odds)
    terms = np.array([*(answer.log_odds for answer in ranked), elsewhere, -np.log(prior_odds)])
    shares = np.exp(terms - np.logaddexp.reduce(terms))
    return Posterior(tuple(ranked), tuple(map(float, shares[:-2])), float(shares[-2]), float(shares[-1]))


def answers_of(hypotheses: Sequence[H], tolerance: tuple[float, float]) -> list[Answer[H]]:
    """Gather hypotheses about the most probable ones, no farther from them than the tolerance (m, rad).

    Models of one pose are one answer also where less is known than is asked for. Of one model each answer has the
    most probable pose: a search may find the same one from many starts.
    """
    found = list[list[H]]()
    ranked = sorted((h for h in hypotheses if np.isfinite(_effective(h))), key=lambda h: -_effective(h))
    for h in ranked:
        same = next((one for one in found if is_same_answer(h, one[0], _told_apart(h, one[0], tolerance))), None)
        if same is None:
            found.append([h])
        elif all(h.model != other.model for other in same):
            same.append(h)
    return [Answer.of(one) for one in found]


def _told_apart(h: H, best: H, tolerance: tuple[float, float]) -> tuple[float, float]:
    if h.model == best.model or best.covariance is None:
        return tolerance
    shift, turn = (RIGHT_WITHIN * sd for sd in worst_sd(best.covariance))
    return max(tolerance[0], shift), max(tolerance[1], turn)


def _effective(h: H) -> float:
    return effective_evidence(h.log_evidence, h.misfit)


def distinct(ranked: Iterable[H], tolerance: tuple[float, float]) -> list[H]:
    """Poses of which no two are one answer, the first of each."""
    kept: list[H] = []
    for h in ranked:
        if not any(is_same_answer(h, other, tolerance) for other in kept):
            kept.append(h)
    return kept


def is_same_answer(one: H, other: H, tolerance: tuple[float, float]) -> bool:
    """Whether two poses of a target are one answer."""
    return is_one_pose(one.T_base_target, other.T_base_target, one.center, tolerance)


def in_order(found: Iterable[H | None]) -> list[H]:
    """Those that exist, with most evidence first."""
    return sorted((one for one in found if one is not None), key=lambda one: -one.log_evidence)


def worst_sd(covariance: Covariance6) -> tuple[float, float]:
    """Standard deviation in the worst direction, of the place (m) and of the turn (rad)."""
    turn, shift = np.linalg.eigvalsh(np.stack([covariance[:3, :3], covariance[3:, 3:]]))[:, -1].tolist()
    return np.sqrt(max(shift, 0.0)), np.sqrt(max(turn, 0.0))
