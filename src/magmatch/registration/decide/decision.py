# SPDX-License-Identifier: BSD-3-Clause
"""Accept or refuse, with the reason in words."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from magmatch.registration.result import Status
from magmatch.registration.weigh.evidence import PoseEvidence

DEGENERATE_REASON = "the data leave a direction free (see degenerate_directions); survey across it"


class DecisionConfig(BaseModel):
    """When a pose is accepted."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Fewest samples' share inside the base map.
    min_overlap: float = Field(default=0.05, ge=0, le=1)
    # Fewest informative cells that agree, and their share among the informative ones.
    min_good_cells: int = Field(default=6, ge=1)
    min_good_share: float = Field(default=0.7, ge=0, le=1)
    # Largest robust normalised residual: about 1 when right, 3 and more for a wrong pose that matches what is smooth.
    max_residual: float = Field(default=3.0, gt=0)
    # Log odds that the pose must have, and by how much it must lead any pose elsewhere, nats.
    min_log_evidence: float = 15.0
    min_lead: float = 10.0
    # The same as a share of those odds: where rooms repeat, poses that explain the field equally well differ by what
    # their edges happen to cover.
    min_relative_lead: float = Field(default=0.5, ge=0)
    # By how much the odds must exceed what the same search reaches in places that do not exist (`decoys.py`), nats;
    # and odds that chance never comes near, for which this is not tried.
    min_decoy_lead: float = 15.0
    # How much more where the cells' residuals exceed what noise and maps explain, nats per factor e: residuals that
    # nothing explains may hide a wrong pose.
    misfit_price: float = Field(default=20.0, ge=0)
    certain_log_evidence: float = 150.0
    # Largest misfit that evidence below that may leave: something moved, and no change that was tried explains it.
    max_misfit: float = Field(default=3.0, gt=0)
    # Largest standard deviation of the pose in its worst direction: rad, and in lengthscales.
    max_sd_rotation: float = Field(default=0.06, gt=0)
    max_sd_translation: float = Field(default=0.3, gt=0)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Status, and in words which check decided and what can be done."""

    status: Status
    reason: str


def odds_in_words(log_odds: float | None, lead: float | None) -> str:
    """Say what speaks for an accepted pose; a lead of None or infinity: no rival."""
    is_alone = lead is None or np.isinf(lead)
    return f"log odds {log_odds:.0f} nats, " + (
        "no rival pose" if is_alone else f"{lead:.0f} nats ahead of any other pose"
    )


def decide(
    ranked: list[PoseEvidence], is_free: bool, lead: float, decoy_evidence: float | None, config: DecisionConfig
) -> Verdict:
    """Judge the best of several poses."""
    if not ranked:
        return Verdict(Status.UNINFORMATIVE, "no pose to judge: the field has no structure to match")
    best = ranked[0]
    accepted = Verdict(
        Status.ACCEPTED,
        f"{best.n_good} of {best.n_informative} informative cells agree, {odds_in_words(best.log_evidence, lead)}",
    )
    return next(_refusals(best, is_free, lead, decoy_evidence, config), accepted)


def _refusals(
    best: PoseEvidence, is_free: bool, lead: float, decoy_evidence: float | None, config: DecisionConfig
) -> Iterator[Verdict]:
    """Reasons against the best pose, the most telling first."""
    if best.overlap < config.min_overlap:
        yield Verdict(
            Status.NO_OVERLAP,
            f"only {best.overlap:.0%} of the target falls inside the base map under the best pose "
            f"(needs {config.min_overlap:.0%}); survey a common region",
        )
    if best.n_informative < config.min_good_cells:
        yield Verdict(
            Status.UNINFORMATIVE,
            f"only {best.n_informative} independent cells of the overlap have a field that stands out "
            f"(needs {config.min_good_cells}): different places, or too little in common; survey a larger area or "
            "closer to iron",
        )
    if best.good_share < config.min_good_share or best.n_good < config.min_good_cells:
        yield Verdict(
            Status.INCONSISTENT,
            f"under the best pose {best.n_good} of {best.n_informative} informative cells agree "
            f"(needs {config.min_good_share:.0%} and {config.min_good_cells}): probably different places",
        )
    if best.residual > config.max_residual:
        yield Verdict(
            Status.INCONSISTENT,
            f"the field differs by {best.residual:.1f} times what the maps' spread allows under the best pose "
            f"(at most {config.max_residual:.1f}): probably different places",
        )
    if not is_free and best.log_evidence < config.min_log_evidence:
        yield Verdict(
            Status.INCONSISTENT,
            f"the evidence for the best pose is {best.log_evidence:.0f} nats (needs {config.min_log_evidence:.0f}); "
            "survey a larger common area",
        )
    if best.misfit > config.max_misfit and best.log_evidence < config.certain_log_evidence:
        yield Verdict(
            Status.INCONSISTENT,
            f"the cells differ by {best.misfit:.1f} times what noise and maps explain under the best pose (at most "
            f"{config.max_misfit:.1f}): too much has moved, or different places",
        )
    needed = config.min_decoy_lead + config.misfit_price * float(np.log(max(best.misfit, 1.0)))
    if decoy_evidence is not None and best.log_evidence < decoy_evidence + needed:
        yield Verdict(
            Status.INCONSISTENT,
            f"the best pose has {best.log_evidence:.0f} nats of evidence, and mirror images of the base, which are "
            f"nowhere, reach {decoy_evidence:.0f} (needs {needed:.0f} more): probably chance; "
            "survey a larger common area",
        )
    needed = max(config.min_lead, config.min_relative_lead * best.log_evidence)
    if lead < needed:
        yield Verdict(
            Status.AMBIGUOUS,
            f"another pose explains the data nearly as well ({lead:.1f} nats behind, needs {needed:.0f}); "
            "see alternatives, or survey more of the surroundings",
        )
    if is_free:
        yield Verdict(Status.DEGENERATE, DEGENERATE_REASON)
