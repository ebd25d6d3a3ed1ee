# SPDX-License-Identifier: BSD-3-Clause
"""Sections of a report that are mostly numbers: key figures, uncertainty, other poses, how to reproduce it."""

import shlex

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.number_text import chance
from magmatch.registration.maps import survey_of
from magmatch.registration.result import RegistrationResult, Sensor
from magmatch.registration.sensor_calibration import in_words as calibration_words
from magmatch.typing import Matrix
from magmatch.viz.figures.agreement_figures import compare
from magmatch.viz.figures.certainty_figures import (
    LEVEL,
    Ellipsoid,
    angle_text,
    direction_words,
    ellipsoid_figure,
    ellipsoids_at,
    free_figure,
    length_text,
    poses_figure,
)
from magmatch.viz.figures.registration_figures import shown_pose
from magmatch.viz.figures.slices import map_in
from magmatch.viz.pages import page

# Other poses that are listed, and samples that give their numbers.
MAX_LISTED, MAX_DRAWN_POSES, N_COMPARED = 10, 6, 500
# Labels of the numbers in a result's evidence; the others have their own names.
EVIDENCE = {
    "log_odds": "evidence for the best pose over unrelated surveys (nats)",
    "effective": "effective evidence, reduced for overdispersion (nats)",
    "lead": "log odds over the best other pose (nats)",
    "misfit": "misfit: residuals relative to what noise and maps explain",
    "probability_elsewhere": "probability of all other poses",
    "probability_unrelated": "probability of unrelated surveys",
    "agreeing_share": "share of informative cells that agree",
    "n_informative": "informative cells",
    "unchanged": "share of cells assumed unchanged",
}
MM, DEG = 1e3, 180 / np.pi


def answer_words(result: RegistrationResult) -> str:
    """The transform in a line, with its standard deviations; empty if there is none."""
    T = result.T_base_target
    if T is None:
        return ""
    words = f"Turned by {turn_words(T)}, moved by {length_text(float(np.linalg.norm(T.translation)))}"
    if (sd := result.standard_deviations) is not None:
        words += f"; sd {angle_text(sd[0])}, {length_text(sd[1])}"
    return words


def figures_table(result: RegistrationResult) -> str:
    """Key figures; those for specialists are collapsed."""
    rows = [["Probability", "not computed" if result.probability is None else chance(result.probability)]]
    if result.base is not None:
        rows.insert(0, ["In map", result.base])
    rows.append(["Overlap", f"{result.overlap:.0%} of the target's samples"])
    if result.residual is not None:
        rows.append(["Normalised residual", f"{result.residual:.2f} (1: model and noise explain all)"])
    rows += [[f"Calibrated {side}", words] for side, words in calibration_words(result.sensor).items()]
    rows += [["Free direction", d.words] for d in result.degenerate_directions]
    others = (
        [] if result.fitness is None else [["Fitness", f"{result.fitness:.3g} (cross product of aligned vectors)"]]
    )
    others.append(["Inliers", f"{result.n_inliers}; {result.n_correspondences} correspondences were tried"])
    others.append(["Keypoints", f"{result.n_keypoints} in both maps together"])
    others += _sensor(result.sensor or Sensor())
    weighed = {name: f"{value:.4g}" for name, value in result.evidence.items() if value is not None}
    others += [[EVIDENCE.get(name, name.replace("_", " ")), text] for name, text in weighed.items()]
    return page.table(rows, named=page.with_terms) + page.details(
        "Numbers behind the decision", page.table(others, named=page.with_terms)
    )


def transform_table(result: RegistrationResult) -> str:
    """The transform, or that there is none."""
    T = result.T_base_target
    if T is None:
        return page.paragraph("No transform: none was accepted.")
    rows = [["Turned by", turn_words(T)], ["Moved by", ", ".join(f"{t:.4f}" for t in T.translation) + " m"]]
    matrix = [[name, *(f"{v:.5f}" for v in row)] for name, row in zip("xyz1", T.as_matrix(), strict=True)]
    words = page.paragraph("T_base_target, with p_base = T_base_target p_target:")
    return page.table(rows) + words + page.table(matrix, ["", "x", "y", "z", "shift (m)"])


def certainty(result: RegistrationResult, target: Survey | None) -> list[page.Section]:
    """Ellipsoids of position and rotation, in words, pictures and numbers; empty if there is no covariance."""
    T = result.T_base_target
    title = "Uncertainty"
    if T is None:
        return []
    if result.covariance is None:
        return [page.Section(title, [page.note("The result has no covariance: the published method gives none.")])]
    blocks = []
    if target is not None:
        place, turn = ellipsoids_at(result.covariance, T, target.centroid)
        where = "around the centroid of the target's samples, base axes"
        blocks = [
            page.paragraph(_ellipsoid_words(place, turn)),
            page.figure_row(
                [
                    ellipsoid_figure(place, "Position of the target", "mm", MM, where),
                    ellipsoid_figure(turn, "Rotation of the target", "deg", DEG, "rotation vector in base axes"),
                ]
            ),
        ]
    origin = page.note("Square roots of the covariance's diagonal. A distant origin makes the shifts large.")
    deviations = page.table(_deviations(result.covariance, result.standard_deviations)) + origin
    blocks.append(page.details("Standard deviations in the target's axes, about its frame's origin", deviations))
    return [page.Section(title, blocks)]


def free_directions(result: RegistrationResult, base: Survey, target: Survey) -> list[page.Section]:
    """Pictures of the free directions."""
    T = shown_pose(result)
    if T is None or not result.degenerate_directions:
        return []
    figures = [free_figure(base, target, T, free) for free in result.degenerate_directions]
    words = f"The data do not constrain the pose against {', '.join(d.words for d in result.degenerate_directions)}."
    return [page.Section("Free directions", [page.paragraph(words), page.figure_row(figures)])]


def other_poses(
    result: RegistrationResult, base: Survey | FieldMap | None, target: Survey | FieldMap | None
) -> list[page.Section]:
    """Rival poses with their numbers; the best candidate first if nothing was accepted."""
    if not result.alternatives:
        return []
    survey = None if target is None else survey_of(target)
    center = np.zeros(3) if survey is None else survey.centroid
    listed = result.alternatives[:MAX_LISTED]
    columns: dict[str, list[str]] = {
        "": [str(k + 1) for k in range(len(listed))],
        "map": [other.base or result.base or "" for other in listed],
        "probability": ["" if other.probability is None else chance(other.probability) for other in listed],
        "log odds (nats)": ["" if other.log_odds is None else f"{other.log_odds:.1f}" for other in listed],
        "turned by": [turn_words(other.T_base_target) for other in listed],
        "moved by (m)": [", ".join(f"{t:.3f}" for t in other.T_base_target.translation) for other in listed],
        "from the answer" if result.is_accepted else "from the first": [
            "" if other.base is not None else _apart(shown_pose(result), other.T_base_target, center)
            for other in listed
        ],
    }
    if (base_map := map_in(base)) is not None and target is not None:
        compared = [
            compare(base_map, target, other.T_base_target, result, N_COMPARED) if other.base is None else None
            for other in listed
        ]
        columns["overlap"] = ["" if c is None else f"{c.overlap:.0%}" for c in compared]
        columns["residual"] = ["" if c is None or c.typical is None else f"{c.typical:.2f}" for c in compared]
    told = {name: cells for name, cells in columns.items() if any(cells)}
    left = len(result.alternatives) - len(listed)
    words = "Poses that fit nearly as well. " if result.is_accepted else "Poses that were considered, best first. "
    words += "Distances refer to the target's centroid. " if target is not None else ""
    words += f"The result file lists {left} more." if left else ""
    rows = [list(row) for row in zip(*told.values(), strict=True)]
    blocks = [page.paragraph(words), page.table(rows, list(told))]
    drawn = [other.T_base_target for other in listed[:MAX_DRAWN_POSES] if other.base is None]
    if base is not None and survey is not None and drawn and not any(other.base for other in listed):
        blocks.append(page.figure_row([poses_figure(survey_of(base), survey, drawn)]))
    return [page.Section("Other poses", blocks)]


def reproduced(result: RegistrationResult, command: str | None) -> page.Section:
    """Command, inputs and settings that reproduce the result."""
    names = [str(entry.get("name", "?")) for entry in result.inputs]
    if command is None:
        names = names if len(names) == 2 else ["BASE", "TARGET"]
        command = f"magmatch register {shlex.join(names)} --config settings.yaml --seed {result.seed}"
    inputs = [
        [name, str(entry.get("sha256", entry.get("SHA-256", "")))]
        for name, entry in zip(names, result.inputs, strict=False)
    ]
    words = (
        f"magmatch {result.version}, seed {result.seed}. The same input, settings and seed give the same "
        "transform. Save the settings below as settings.yaml, or pass the result file itself to --config."
    )
    listed = [page.table(inputs, ["input", "SHA-256"])] if inputs else []
    return page.again("Reproduce this result", words, command, result.config, *listed)


def turn_words(T: RigidTransform) -> str:
    """A rotation as angle and axis."""
    vector = T.rotation.as_rotvec()
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return "0.00 deg"
    return f"{np.rad2deg(angle):.2f} deg about ({', '.join(f'{c:.2f}' for c in vector / angle)})"


def _ellipsoid_words(place: Ellipsoid, turn: Ellipsoid) -> str:
    shift = [length_text(half) for half in place.half_axes]
    return (
        f"With {LEVEL:.0%} probability the target's centroid lies within {shift[0]} of where the transform puts it "
        f"(least certain along {direction_words(place.directions[0])}, within {shift[2]} across), and its rotation "
        f"is within {angle_text(turn.half_axes[0])} (least certain about {direction_words(turn.directions[0])})."
    )


def _deviations(covariance: Matrix, best: tuple[float, float] | None) -> list[list[str]]:
    """Roots of the covariance's diagonal in words."""
    sd = np.sqrt(np.diag(covariance))
    axes = ["about x", "about y", "about z", "origin along x", "origin along y", "origin along z"]
    text = [f"{DEG * s:.3f} deg" for s in sd[:3]] + [f"{MM * s:.1f} mm" for s in sd[3:]]
    rows = [[axis, words] for axis, words in zip(axes, text, strict=True)]
    turn, shift = best or (0.0, 0.0)
    return [["where the data constrain it best", f"{DEG * turn:.3f} deg, {MM * shift:.1f} mm"], *rows]


def _apart(first: RigidTransform | None, T: RigidTransform, center: np.ndarray) -> str:
    if first is None or first is T:
        return ""
    angle = np.rad2deg((first.rotation.inv() * T.rotation).magnitude())
    return f"{np.linalg.norm(first.apply(center) - T.apply(center)):.3g} m, {angle:.1f} deg"


def _sensor(sensor: Sensor) -> list[list[str]]:
    """Differences between the two magnetometers, if they were estimated."""
    rows = []
    if sensor.get("bias") is not None:
        rows.append(["Sensor bias", ", ".join(f"{1e9 * b:.0f}" for b in sensor["bias"]) + " nT"])
    if sensor.get("scale") is not None:
        rows.append(["Sensor scale", f"{sensor['scale']:.4f}"])
    return rows
