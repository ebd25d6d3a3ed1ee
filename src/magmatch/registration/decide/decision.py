# SPDX-License-Identifier: BSD-3-Clause
"""One principle: a pose is accepted if it is probable enough and known accurately enough; otherwise, why not."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from magmatch.estimation.pose_prior import RARE
from magmatch.estimation.posterior import RIGHT_WITHIN, Hypothesis, Posterior, needed_evidence, worst_sd
from magmatch.registration.decide.estimate import Estimate
from magmatch.registration.result import Status
from magmatch.settings import Settings
from magmatch.typing import Covariance6

# Largest standard deviation of the target's position where none is asked for, in correlation lengths of the field.
MAX_SD_IN_LENGTHS = 0.3
# Poses that differ by more than `RIGHT_WITHIN` times this rotation (rad), or that position, are two answers: that a
# coarser pose would do does not make two places one.
SAME_SD_ROTATION = 0.08


class DecisionConfig(Settings):
    """When a pose is accepted."""

    # Least probability that the pose is right.
    min_probability: float = Field(default=1 - RARE, gt=0, lt=1)
    # Largest standard deviation in the worst direction: of the target's position, m (None: 0.3 of the field's
    # correlation length), and of its rotation, rad (10 degrees: headings of phones' walks are known to 5 and more).
    max_sd_translation: float | None = Field(default=None, gt=0)
    max_sd_rotation: float = Field(default=0.1745, gt=0)
    # Prior odds that both surveys cover a common place, before their fields are compared.
    prior_odds: float = Field(default=1.0, gt=0)

    def max_sd(self, length: float) -> tuple[float, float]:
        """Largest standard deviations (m, rad), given the field's correlation length (m)."""
        return self.max_sd_translation or MAX_SD_IN_LENGTHS * length, self.max_sd_rotation

    def tolerance(self, length: float) -> tuple[float, float]:
        """Within what two poses are one answer (m, rad): errors that count as right, and less than may be stated."""
        shift, turn = self.max_sd(length)
        return RIGHT_WITHIN * min(shift, MAX_SD_IN_LENGTHS * length), RIGHT_WITHIN * min(turn, SAME_SD_ROTATION)


def is_sharp(covariance: Covariance6 | None) -> bool:
    """Whether a pose is known as well as answers are told apart, so that another look is not needed."""
    return covariance is not None and bool(worst_sd(covariance)[1] <= SAME_SD_ROTATION)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Status, and in words why, and what can be done."""

    status: Status
    reason: str


NO_POSE = Verdict(
    Status.UNINFORMATIVE,
    "no pose to judge: the surveys share too little, or the field has no structure to match; survey closer to iron",
)


def decide(posterior: Posterior[Hypothesis], estimate: Estimate, length: float, config: DecisionConfig) -> Verdict:
    """Decide on the most probable of the poses, of which there is at least one; ``length``: the field's scale, m."""
    if posterior.best >= config.min_probability:
        return _accepted(posterior, estimate, config.max_sd(length))
    best = posterior.poses[0]
    if posterior.rivals > posterior.null:
        return Verdict(
            Status.AMBIGUOUS,
            f"the best pose has probability {too_low(posterior.best)}, other poses {posterior.rivals:.2g} together "
            "(see alternatives); survey more of the surroundings",
        )
    needed = needed_evidence(config.min_probability, best.kind, config.prior_odds)
    if best.attainable < needed <= best.attainable / max(best.overlap, 1e-9):
        return Verdict(
            Status.NO_OVERLAP,
            f"only {best.overlap:.0%} of the target falls inside the base under the best pose, too little to tell a "
            "match from chance; survey a common region",
        )
    attainable = max(pose.attainable for pose in posterior.poses)
    if attainable < needed:
        return Verdict(
            Status.UNINFORMATIVE,
            f"the field that both surveys may share has too little structure: a perfect match would reach "
            f"{np.floor(max(attainable, 0)):.0f} nats, {np.ceil(needed):.0f} are needed; "
            "survey a larger area or closer to iron",
        )
    effective = posterior.answers[0].effective
    likely = "probably different places" if posterior.null > 0.5 else "perhaps different places"
    return Verdict(
        Status.INCONSISTENT,
        f"{likely}: the best pose has probability {too_low(posterior.best)} ({np.floor(effective):.0f} nats of "
        f"evidence, {np.ceil(needed):.0f} are needed)",
    )


def _accepted(posterior: Posterior[Hypothesis], estimate: Estimate, max_sd: tuple[float, float]) -> Verdict:
    """Decide on a probable pose: accepted if every direction is known accurately enough."""
    free = estimate.free_directions(max_sd)
    if estimate.covariance is not None and not free:
        return Verdict(Status.ACCEPTED, f"probability {in_words(posterior.best)}, {_lead(posterior)}")
    place = f"the place is found (probability {in_words(posterior.best)})"
    if estimate.covariance is None:
        return Verdict(
            Status.DEGENERATE, f"{place}, but the data determine the pose in no direction; survey a larger area"
        )
    shift, turn = estimate.worst_sd
    words = "in every direction" if len(free) == 6 else ", ".join(d.words for d in free) + " is free"
    return Verdict(
        Status.DEGENERATE,
        f"{place}, but the pose is known to {shift:.2g} m and {np.degrees(turn):.2g} deg only, where "
        f"{max_sd[0]:.2g} m and {np.degrees(max_sd[1]):.2g} deg are required: {words}; "
        "survey a larger area, or across it",
    )


def in_words(probability: float) -> str:
    """A probability, rounded to its first digit that is not nine."""
    if probability > 1 - 1e-6:
        return "above 0.999999"
    return f"{probability:.{int(np.clip(np.ceil(-np.log10(1 - probability)), 2, 6))}f}"


def too_low(probability: float) -> str:
    """A probability that does not suffice, rounded down, so that it never reads as if it did."""
    return f"{np.floor(1e3 * probability) / 1e3:.3f}" if probability > 0.9 else f"{probability:.2g}"


def _lead(posterior: Posterior[Hypothesis]) -> str:
    evidence = f"{posterior.poses[0].log_evidence:.0f} nats of evidence"
    return evidence if posterior.lead is None else f"{evidence}, {posterior.lead:.0f} nats ahead of any other pose"
