# SPDX-License-Identifier: BSD-3-Clause
"""What a registration's status means, and what its user can do next."""

from magmatch.registration.result import RegistrationResult, Status

MEANING = {
    Status.ACCEPTED: "Both surveys are of one place; the transform below brings the target into the base's frame.",
    Status.AMBIGUOUS: "The target fits the base in more than one way: the field repeats itself, so which fit is "
    "right cannot be told from these data.",
    Status.DEGENERATE: "The surveys fit, but along some direction the field hardly changes, so that the target "
    "could be moved that way without the data objecting.",
    Status.NO_OVERLAP: "Hardly any of the target falls where the base map knows the field: what little does is no "
    "evidence for a transform.",
    Status.UNINFORMATIVE: "The field has too little structure, compared with noise, to tell one place from another.",
    Status.INCONSISTENT: "Even the best pose found does not explain the target's field by the base's. Different "
    "places look like this; so does one place where something went wrong with the data.",
}

# What helps, the most likely first.
NEXT_STEPS = {
    Status.ACCEPTED: (
        "Use it: 'magmatch transform TARGET --by RESULT.json --out ALIGNED.csv' moves the target, 'magmatch convert "
        "RESULT.json' writes it for g2o, TUM or ROS.",
        "Look at the residuals below: 1 or less nearly everywhere is as it should be. A patch that stands out is "
        "iron that was moved between the surveys, or a gap in the base.",
    ),
    Status.AMBIGUOUS: (
        "Look at the other poses below: if you know roughly where the target was, say so with --prior-pose and "
        "register again.",
        "If z points up in both surveys, say --gravity-aligned: it leaves fewer poses to tell apart.",
        "Survey more of the surroundings, in base or target, until something is included that does not repeat (a "
        "door, a pillar, an end of the row of racks).",
    ),
    Status.DEGENERATE: (
        "Survey across the free direction drawn below: turn a corner, add a second line beside the first, or a "
        "second height.",
        "If another sensor fixes that direction (wheel odometry, a floor plan), say so with --prior-pose.",
    ),
    Status.NO_OVERLAP: (
        "Survey a region in common: at least a few correlation lengths across, in both surveys.",
        "If they should overlap, check the units of length: --base-length-unit and --target-length-unit.",
        "If the base was made with --domain, see whether the box holds the place.",
    ),
    Status.UNINFORMATIVE: (
        "If z points up in both surveys, or the pose is known roughly, say --gravity-aligned or --prior-pose: less "
        "has to be found out from the field.",
        "Survey nearer to iron (walls, floors with rebar, furniture), or a larger region.",
        "Check the units and the resolution of the field: 'magmatch info' shows how much it varies in each survey.",
    ),
    Status.INCONSISTENT: (
        "If these are different places, this is the right answer.",
        "If they are one place, check how the vectors are given: in the sensor's frame they need --field-frame "
        "sensor; see also --base-field-unit and --target-field-unit.",
        "Calibrate raw logs first ('magmatch prepare'): hard iron or a clock offset can be enough for "
        "this. Sensors that differ a lot: --sensor full.",
        "Iron moved in between (cars, lifts, doors) spoils what is near it; leave those samples out.",
    ),
}


def headline(result: RegistrationResult) -> str:
    """The answer in a line."""
    words = "Accepted" if result.is_accepted else f"Not accepted: {result.status.replace('_', ' ')}"
    if result.probability is not None:
        of = "" if result.is_accepted else "best candidate: "
        words += f" ({of}probability of being right {percent(result.probability)})"
    return words


def percent(probability: float) -> str:
    """A probability with the digits that matter near 0 and 1: never rounded to certainty."""
    if 0 < probability < 0.0005:
        return "below 0.1 %"
    if 0.9995 < probability < 1:
        return "above 99.9 %"
    return f"{100 * probability:.1f} %"


def next_steps(result: RegistrationResult) -> list[str]:
    """What the user can do, the most promising first."""
    steps = list(NEXT_STEPS[result.status])
    if result.alternatives and not result.is_accepted:
        steps.append(
            "The best candidate is drawn below and stands first under 'alternatives' of the result file. It is not "
            "an answer: treat it as a guess to be checked."
        )
    return steps
