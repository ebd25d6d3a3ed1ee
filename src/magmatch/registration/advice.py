# SPDX-License-Identifier: BSD-3-Clause
"""Two surveys do not seem to match: the most likely remedy is named first."""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from magmatch.data.diagnoses import constant_field, diagnose, of_verticals
from magmatch.data.survey import Survey
from magmatch.estimation.pose_prior import PosePriorConfig
from magmatch.estimation.walk import MAX_BREADTH
from magmatch.field.folds import has_path_order
from magmatch.registration.result import RegistrationResult, Status
from magmatch.registration.weigh.bend import DRIFTS


def with_advice(
    answer: RegistrationResult, surveys: Mapping[str, Survey], prior: PosePriorConfig
) -> RegistrationResult:
    """A refusal, its reason extended by a survey's fault or, if no single pose fits, by remedies."""
    if answer.is_accepted:
        return answer
    if wrong := without_structure(surveys) or diagnosis(surveys) or contradiction(surveys, prior):
        return replace(answer, reason=f"{wrong}; {answer.reason}")
    rigid = (Status.INCONSISTENT, Status.AMBIGUOUS, Status.NO_OVERLAP)
    if DRIFTS in answer.reason or answer.status not in rigid:
        return answer
    remedies = [remedy(surveys, prior)] if answer.status is Status.INCONSISTENT else []
    remedies += of_maps(answer) or of_odometry(surveys)
    return replace(answer, reason="; ".join([answer.reason, *remedies])) if remedies else answer


def without_structure(surveys: Mapping[str, Survey]) -> str:
    """In one clause, the first survey whose field is constant; empty if there is none."""
    return next((f"{side}: {words}" for side, survey in surveys.items() if (words := constant_field(survey))), "")


def diagnosis(surveys: Mapping[str, Survey]) -> str:
    """In one clause, the first fault of the surveys; empty if there is none."""
    found = {side: diagnoses[0] for side, survey in surveys.items() if (diagnoses := diagnose(survey))}
    if not found:
        return ""
    side, first = next(iter(found.items()))
    if len(found) > 1 and len({one.kind for one in found.values()}) == 1:
        return f"both surveys: {first}"
    return f"{side}: {re.sub('--(?=field|columns|extrinsic)', f'--{side}-', str(first))}"


def contradiction(surveys: Mapping[str, Survey], prior: PosePriorConfig) -> str:
    """In one clause, how the surveys contradict what is stated of z in both; empty if they do not."""
    if len(surveys) < 2 or not prior.is_upright:
        return ""
    found = [str(one) for one in of_verticals(*surveys.values())]
    (low, high), (other_low, other_high) = ((z.min(), z.max()) for z in (s.positions[:, 2] for s in surveys.values()))
    apart = max(low - other_high, other_low - high)
    if prior.is_planar and apart > 3 * prior.height_sd:
        found.append(
            f"the surveys' heights differ by {apart:.2g} m, and --planar has them agree: use --gravity-aligned"
        )
    return "; ".join(found)


def remedy(surveys: Mapping[str, Survey], prior: PosePriorConfig) -> str:
    """In one clause, the most helpful remedy if the surveys are of the same place."""
    if prior.pose is not None:
        return "if they are of one place, the pose that was stated is wrong: leave it out, or widen --prior-pose-sd"
    # Where z is up in one of them only, to state that it is does not help.
    is_known = prior.is_upright or bool(len(surveys) == 2 and of_verticals(*surveys.values()))
    if not is_known and len(surveys) == 2 and all(_is_flat(survey) for survey in surveys.values()):
        return (
            "both surveys are flat: if z is up in both, use --gravity-aligned (--planar if their heights agree too)"
        )
    more = "--prior-pose" if is_known else "--gravity-aligned"
    return f"if they do share a region, survey more of it, or state what is known of the pose ({more})"


def of_maps(answer: RegistrationResult) -> list[str]:
    """In one clause, the two maps of a folder that hold the target alike; none if the rival is in the same map."""
    rival = max(answer.alternatives[1:], key=lambda pose: pose.probability or 0.0, default=None)
    if answer.status is not Status.AMBIGUOUS or rival is None or rival.base is None:
        return []
    both = f"the target fits in {answer.base} and in {rival.base}"
    return [f"{both}: if they are maps of one place, keep one, or make one of both (magmatch merge)"]


def of_odometry(surveys: Mapping[str, Survey]) -> list[str]:
    """In one clause, what to do about positions along a path that may drift; none if no survey follows a path."""
    walked = [side for side, survey in surveys.items() if has_path_order(survey.positions)]
    if not walked:
        return []
    whose = "both surveys" if len(walked) == 2 else f"the {walked[0]}"
    return [f"if the positions of {whose} are odometry that drifts, correct them with magmatch slam first"]


def _is_flat(survey: Survey) -> bool:
    extent = np.linalg.svd(survey.positions - survey.centroid, compute_uv=False)
    return bool(extent[2] < MAX_BREADTH * extent[1])
