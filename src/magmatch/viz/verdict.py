# SPDX-License-Identifier: BSD-3-Clause
"""A registration's status has a meaning, and its user can do something next."""

from magmatch.number_text import chance
from magmatch.registration.result import RegistrationResult, Status

MEANING = {
    Status.ACCEPTED: "Both surveys cover one place; the transform below brings the target into the base's frame.",
    Status.AMBIGUOUS: "The target fits the base in more than one way. The field repeats itself, and these data "
    "cannot decide which fit is right.",
    Status.DEGENERATE: "The surveys fit, but along some direction the field hardly changes: the target could be "
    "moved that way and still fit.",
    Status.NO_OVERLAP: "Hardly any of the target lies where the base map knows the field, too little to support a "
    "transform.",
    Status.UNINFORMATIVE: "The field has too little structure, compared with noise, to tell one place from another.",
    Status.INCONSISTENT: "Even the best pose does not explain the target's field. Surveys of different places look "
    "like this, and so does one place when something went wrong with the data.",
}

IF_UPRIGHT = "If z points up in both surveys, pass --gravity-aligned: fewer poses are then possible."
# What helps, the most likely first.
NEXT_STEPS = {
    Status.ACCEPTED: (
        "Use it: 'magmatch transform TARGET --by RESULT.json --out ALIGNED.csv' moves the target, 'magmatch convert "
        "RESULT.json' writes it for g2o, TUM or ROS.",
        "Check the residuals below: they should be 1 or less nearly everywhere. A patch that stands out means that "
        "iron moved between the surveys, or that the base has a gap there.",
    ),
    Status.AMBIGUOUS: (
        "Look at the other poses below. If you know roughly where the target was, pass --prior-pose and register "
        "again.",
        IF_UPRIGHT,
        "Survey more of the surroundings, in base or target, until they include something that does not repeat (a "
        "door, a pillar, the end of a row of racks).",
    ),
    Status.DEGENERATE: (
        "Survey across the free direction drawn below: turn a corner, add a second line beside the first, or a "
        "second height.",
        "If something else fixes that direction (wheel odometry, a floor plan), pass it as --prior-pose.",
    ),
    Status.NO_OVERLAP: (
        "Survey a common region, at least a few correlation lengths across.",
        "If the surveys should overlap, check their length units: --base-length-unit and --target-length-unit.",
        "If the base was made with --domain, check that the box contains the place.",
    ),
    Status.UNINFORMATIVE: (
        IF_UPRIGHT,
        "If you know the pose roughly, pass --prior-pose: the field then has less to determine.",
        "Survey nearer to iron (walls, floors with rebar, furniture), or a larger region.",
        "Check the units and the resolution of the field: 'magmatch info' shows how much it varies in each survey.",
    ),
    Status.INCONSISTENT: (
        "If these are different places, this is the right answer.",
        "If they are one place, check the field vectors: their frame (--field-frame sensor for the sensor's own) and "
        "their units (--base-field-unit, --target-field-unit).",
        "Calibrate raw logs first ('magmatch prepare'): hard iron or a clock offset alone can cause this. If the "
        "sensors differ a lot, pass --sensor full.",
        "Iron that moved between the surveys (cars, lifts, doors) spoils the samples near it; leave them out.",
    ),
}


def headline(result: RegistrationResult) -> str:
    """The answer in a line."""
    words = "Accepted" if result.is_accepted else f"Not accepted: {result.status.replace('_', ' ')}"
    if result.probability is not None:
        of = "" if result.is_accepted else "best candidate: "
        words += f" ({of}probability of being right {chance(result.probability)})"
    return words


def next_steps(result: RegistrationResult) -> list[str]:
    """List what the user can do, the most promising first."""
    prior = result.config.get("prior", {})
    is_upright = prior.get("is_gravity_aligned") or prior.get("is_planar")
    steps = [step for step in NEXT_STEPS[result.status] if step != IF_UPRIGHT or not is_upright]
    if result.alternatives and not result.is_accepted:
        steps.append(
            "The best candidate is drawn below and comes first under 'alternatives' in the result file. It is a "
            "guess to check, not an answer."
        )
    return steps
