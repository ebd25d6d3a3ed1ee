# SPDX-License-Identifier: BSD-3-Clause
"""Posterior probabilities of the poses, and of the hypothesis that the two surveys are unrelated.

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
from typing import Generic, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from magmatch.geometry import is_one_pose
from magmatch.registration.weigh.hypothesis import Hypothesis, Kind

H = TypeVar("H", bound=Hypothesis)


class Fitted(BaseModel):
    """The numbers of the law above."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    scale: float = Field(gt=0)
    saturation: float = Field(gt=0)  # nats: evidence above which it counts logarithmically
    # For each kind of evidence, a correction for what unrelated surveys reach; 0 if nothing was fitted
    offset: dict[Kind, float]


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
    numbers = numbers or law_of(kind)
    if not np.isfinite(log_evidence):
        return -np.inf
    effective = effective_evidence(log_evidence, misfit)
    return float(numbers.scale * np.arcsinh(effective / numbers.saturation) - numbers.offset.get(kind, 0.0))


def needed_evidence(probability: float, kind: Kind, prior_odds: float = 1.0) -> float:
    """Effective evidence that a pose without rivals needs for a given probability, nats."""
    numbers = fitted()
    wanted = np.log(probability / (1 - probability)) - np.log(prior_odds) + numbers.offset[kind]
    return float(numbers.saturation * np.sinh(wanted / numbers.scale))


@dataclass(frozen=True, eq=False, slots=True)
class Posterior(Generic[H]):
    """Probabilities of mutually exclusive poses and of unrelated surveys; they sum to one."""

    poses: tuple[H, ...]  # most probable first
    probabilities: tuple[float, ...]  # one per pose
    elsewhere: float  # of the best pose in another base
    null: float  # that base and target are unrelated

    @property
    def best(self) -> float:
        """Probability of the most probable pose; 0 if there is none."""
        return self.probabilities[0] if self.probabilities else 0.0

    @property
    def rivals(self) -> float:
        """Probability of all other poses together."""
        return sum(self.probabilities[1:]) + self.elsewhere

    @property
    def lead(self) -> float | None:
        """Log odds of the most probable pose over any other, nats; None if there is no other."""
        rival = max([*self.probabilities[1:], self.elsewhere])
        return float(np.log(self.best / rival)) if rival > 0 and self.best > 0 else None


def posterior_over(
    hypotheses: Sequence[H], tolerance: tuple[float, float], prior_odds: float = 1.0, elsewhere: float = -np.inf
) -> Posterior[H]:
    """Weigh poses of one target in one base against each other and against unrelated surveys.

    Poses no farther apart than the tolerance (m, rad), at the target's centre, are one answer; the more probable is
    kept. ``prior_odds``: that both surveys cover a common place; ``elsewhere``: log odds of the best pose in another
    base, nats.
    """
    return posterior_of(distinct(_ranked(hypotheses), tolerance), prior_odds, elsewhere)


def posterior_of(distinct: Sequence[H], prior_odds: float = 1.0, elsewhere: float = -np.inf) -> Posterior[H]:
    """`posterior_over` for poses of which no two are one answer."""
    kept = _ranked(distinct)
    odds = [log_odds(h.log_evidence, h.misfit, h.kind) for h in kept]
    terms = np.array([*odds, elsewhere, -np.log(prior_odds)])
    shares = np.exp(terms - np.logaddexp.reduce(terms))
    return Posterior(tuple(kept), tuple(map(float, shares[:-2])), float(shares[-2]), float(shares[-1]))


def _ranked(hypotheses: Sequence[H]) -> list[H]:
    odds = {id(h): log_odds(h.log_evidence, h.misfit, h.kind) for h in hypotheses}
    return sorted((h for h in hypotheses if np.isfinite(odds[id(h)])), key=lambda h: -odds[id(h)])


def distinct(ranked: Iterable[H], tolerance: tuple[float, float]) -> list[H]:
    """Poses of which no two are one answer, the first of each."""
    kept: list[H] = []
    for h in ranked:
        if not any(is_same_answer(h, other, tolerance) for other in kept):
            kept.append(h)
    return kept


def is_same_answer(one: Hypothesis, other: Hypothesis, tolerance: tuple[float, float]) -> bool:
    """Whether two poses of a target are one answer."""
    return is_one_pose(one.T_base_target, other.T_base_target, one.center, tolerance)
