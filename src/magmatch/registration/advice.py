# SPDX-License-Identifier: BSD-3-Clause
"""What to try where two surveys do not seem to match: the likeliest remedy first."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from magmatch.data.diagnoses import diagnose, of_verticals
from magmatch.data.survey import Survey
from magmatch.registration.prepared.pose_prior import PosePriorConfig
from magmatch.registration.result import RegistrationResult, Status

# Extent across a plane over the extent along it.
FLAT = 0.1


def with_advice(
    answer: RegistrationResult, surveys: Mapping[str, Survey], prior: PosePriorConfig
) -> RegistrationResult:
    """A refusal that begins with what is wrong with a survey; else with a remedy where they seem to be two places."""
    if answer.is_accepted:
        return answer
    if wrong := diagnosis(surveys) or contradiction(surveys, prior):
        return replace(answer, reason=f"{wrong}; {answer.reason}")
    if answer.status is not Status.INCONSISTENT:
        return answer
    return replace(answer, reason=f"{answer.reason}; {remedy(surveys, prior)}")


def diagnosis(surveys: Mapping[str, Survey]) -> str:
    """In one clause, what is wrong with the surveys: of one kind, what comes first; empty where nothing is."""
    found = {side: diagnoses[0] for side, survey in surveys.items() if (diagnoses := diagnose(survey))}
    if not found:
        return ""
    side, first = next(iter(found.items()))
    if len(found) > 1 and len({one.kind for one in found.values()}) == 1:
        return f"both surveys: {first}"
    return f"{side}: {first}".replace("--field", f"--{side}-field")


def contradiction(surveys: Mapping[str, Survey], prior: PosePriorConfig) -> str:
    """In one clause, how the surveys' fields contradict that both are upright; empty where they do not."""
    if len(surveys) < 2 or not (prior.is_gravity_aligned or prior.is_planar):
        return ""
    return "; ".join(str(one) for one in of_verticals(*surveys.values()))


def remedy(surveys: Mapping[str, Survey], prior: PosePriorConfig) -> str:
    """In one clause, what would help most if the surveys are of one place."""
    is_known = prior.is_gravity_aligned or prior.is_planar
    if not is_known and len(surveys) == 2 and all(_is_flat(survey) for survey in surveys.values()):
        return (
            "both surveys are flat: if z is up in both, say --gravity-aligned (--planar if heights are the same too)"
        )
    return "if they do share a region, survey more of it, or say what is known of the pose (--gravity-aligned)"


def _is_flat(survey: Survey) -> bool:
    extent = np.linalg.svd(survey.positions - survey.centroid, compute_uv=False)
    return bool(extent[2] < FLAT * extent[1])
