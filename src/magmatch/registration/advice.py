# SPDX-License-Identifier: BSD-3-Clause
"""What to try where two surveys do not seem to match: the likeliest remedy first."""

from dataclasses import replace

import numpy as np

from magmatch.data.survey import Survey
from magmatch.registration.prepared.pose_prior import PosePriorConfig
from magmatch.registration.result import RegistrationResult, Status

# Mean vector over mean norm: Earth's field keeps it near one in a frame that stands still.
TURNING = 0.5
# Extent across a plane over the extent along it.
FLAT = 0.1


def with_advice(
    answer: RegistrationResult, base: Survey, target: Survey, prior: PosePriorConfig
) -> RegistrationResult:
    """The answer, with a remedy where base and target seem to be different places."""
    if answer.status is not Status.INCONSISTENT:
        return answer
    return replace(answer, reason=f"{answer.reason}; {remedy(base, target, prior)}")


def remedy(base: Survey, target: Survey, prior: PosePriorConfig) -> str:
    """In one clause, what would help most if the surveys are of one place."""
    for side, survey in (("base", base), ("target", target)):
        if _points_every_way(survey):
            return (
                f"the {side}'s vectors point every way, as those of a sensor do that turns: if they are in its axes, "
                f"say --{side}-field-frame sensor and give orientations"
            )
    if not (prior.is_gravity_aligned or prior.is_planar) and _is_flat(base) and _is_flat(target):
        return (
            "both surveys are flat: if z is up in both, say --gravity-aligned (--planar if heights are the same too)"
        )
    return "if they do share a region, survey more of it, or say what is known of the pose (--gravity-aligned)"


def _points_every_way(survey: Survey) -> bool:
    """Whether the vectors' directions cancel, as they do in no frame that stands still in Earth's field."""
    norms = np.linalg.norm(survey.field, axis=1)
    return bool(np.linalg.norm(survey.field.mean(axis=0)) < TURNING * norms.mean())


def _is_flat(survey: Survey) -> bool:
    extent = np.linalg.svd(survey.positions - survey.centroid, compute_uv=False)
    return bool(extent[2] < FLAT * extent[1])
