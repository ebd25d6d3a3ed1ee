# SPDX-License-Identifier: BSD-3-Clause
"""The report of a registration: the verdict in words, the pictures, the numbers, and how to reproduce it."""

import shlex
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey, has_order
from magmatch.field.map import FieldMap
from magmatch.number_text import chance, deviations
from magmatch.published.config import PublishedConfig
from magmatch.registration.maps import survey_of
from magmatch.registration.result import RegistrationResult, Sensor
from magmatch.registration.sensor_calibration import in_words as calibration_words
from magmatch.typing import Matrix
from magmatch.viz.figures.agreement_figures import LARGEST_ORDINARY, agreement_figures, along_figure, compare
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
from magmatch.viz.figures.published_figures import published_figures
from magmatch.viz.figures.registration_figures import (
    match_figure,
    scene_figures,
    shown_pose,
    slice_figures,
)
from magmatch.viz.figures.slices import map_in
from magmatch.viz.pages import page
from magmatch.viz.verdict import headline, meaning, steps_after

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


def write_report(
    path: str | Path,
    base: Survey | FieldMap | None,
    target: Survey | FieldMap | None,
    result: RegistrationResult,
    command: str | None = None,
    published: PublishedConfig | None = None,
) -> None:
    """Write one HTML page about a registration; it works offline and on a phone.

    Maps add slices and residuals; without base or target nothing is drawn. `command` reproduces the result, with
    the settings in ``settings.yaml``. Settings of the published method, if it was that, add what it saw in both maps.
    """
    sections = [_answer(result)]
    if base is not None and target is not None:
        base_survey, target_survey = survey_of(base), survey_of(target)
        sections.append(
            page.Section("In space", [page.figure_row(scene_figures(base_survey, target_survey, result))])
        )
        base_map, target_map = map_in(base), map_in(target)
        if base_map is not None and target_map is not None:
            sections += _field(base_map, target_map, result)
            if published is not None:
                figures = published_figures(base_map, target_map, result.links, published).values()
                sections.append(
                    page.Section("What the published method sees", [page.figure_row([one]) for one in figures])
                )
        sections += _agreement(base_map, target, result)
        sections += _certainty(result, target_survey)
        sections += _free_directions(result, base_survey, target_survey)
    else:
        sections += _certainty(result, None)
    sections += _other_poses(result, base, target)
    in_numbers = page.columns([_transform(result)], [_figures(result)])
    seconds = [[stage, f"{s:.2f} s"] for stage, s in result.seconds.items()]
    times = [page.details("Time per stage", page.table(seconds))] if seconds else []
    sections.append(page.Section("In numbers", [in_numbers, *times]))
    sections.append(_reproduced(result, command))
    page.write_page(path, _title(result), sections)


def _title(result: RegistrationResult) -> str:
    names = [str(entry.get("name", "?")) for entry in result.inputs]
    return f"magmatch: {names[1]} in the frame of {names[0]}" if len(names) == 2 else "magmatch: registration"


def _answer(result: RegistrationResult) -> page.Section:
    """The verdict, what it means, and what to do next."""
    return page.Section(
        "",
        [
            page.verdict(headline(result), result.reason, _answer_words(result), is_good=result.is_accepted),
            page.paragraph(meaning(result.status)),
            page.details("What to do next", page.bullets(steps_after(result)), is_open=not result.is_accepted),
        ],
    )


def _field(base: FieldMap, target: FieldMap, result: RegistrationResult) -> list[page.Section]:
    """Both maps on one cut, and side by side with the links between them."""
    blocks = [
        page.note("One colour scale for both maps. Blank: the map has no samples nearby."),
        page.figure_row(slice_figures(base, target, result)),
    ]
    matches = match_figure(base.survey, target.survey, result.links)
    if matches is not None:
        blocks.append(page.details("Matching keypoints", page.figure_row([matches])))
    return [page.Section("The field of both maps", blocks)]


def _agreement(base: FieldMap | None, target: Survey | FieldMap, result: RegistrationResult) -> list[page.Section]:
    """Whether the base explains the target's samples, under the pose that is shown."""
    T_base_target = shown_pose(result)
    if T_base_target is None:
        return []
    title = "Overlap and residuals"
    if base is None:
        words = "This needs a map of the base. None could be made: too few samples, or settings of another version."
        return [page.Section(title, [page.note(words)])]
    compared = compare(base, target, T_base_target, result)
    n, n_all = len(compared.rows), len(survey_of(target))
    words = f"Based on {n} of the target's {n_all} samples, evenly chosen. " if n < n_all else ""
    if not result.is_accepted:
        words += "The pose is the best candidate, which was not accepted. "
    if compared.rms is None:
        words += "None of the samples lies where the base map knows the field."
    else:
        n_large, n_known = compared.is_large.sum(), compared.is_known.sum()
        words += (
            f"In the overlap the median residual is {compared.typical:.2f} times what noise and the uncertainty of "
            "the base map explain (the figure at the top is the registration's own, from its grid and samples). The "
            f"root mean square, in which single bad samples count in full, is {compared.rms:.2f}. {n_large} of "
            f"{n_known} samples exceed {LARGEST_ORDINARY:.1f}; 1 in 1000 would by chance."
        )
    blocks = [page.paragraph(words), page.figure_row(agreement_figures(base, compared))]
    if compared.rms is not None and has_order(survey_of(target)):
        blocks.append(page.figure_row([along_figure(compared)]))
    return [page.Section(title, blocks)]


def _answer_words(result: RegistrationResult) -> str:
    """The transform in a line, with its standard deviations; empty if there is none."""
    T = result.T_base_target
    if T is None:
        return ""
    words = f"Turned by {turn_words(T)}, moved by {length_text(float(np.linalg.norm(T.translation)))}"
    if (sd := result.standard_deviations) is not None:
        words += f"; sd {deviations(*sd)} where the data constrain it best"
    return words


def _figures(result: RegistrationResult) -> str:
    """Key figures; those for specialists are collapsed."""
    rows = [] if result.base is None else [["In map", result.base]]
    rows.append(["Probability", "not computed" if result.probability is None else chance(result.probability)])
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


def _transform(result: RegistrationResult) -> str:
    """The transform, or that there is none."""
    T = result.T_base_target
    if T is None:
        return page.paragraph("No transform: none was accepted.")
    rows = [["Turned by", turn_words(T)], ["Moved by", ", ".join(f"{t:.4f}" for t in T.translation) + " m"]]
    matrix = [[name, *(f"{v:.5f}" for v in row)] for name, row in zip("xyz1", T.as_matrix(), strict=True)]
    words = page.paragraph("T_base_target, with p_base = T_base_target p_target:")
    return page.table(rows) + words + page.table(matrix, ["", "x", "y", "z", "shift (m)"])


def _certainty(result: RegistrationResult, target: Survey | None) -> list[page.Section]:
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


def _free_directions(result: RegistrationResult, base: Survey, target: Survey) -> list[page.Section]:
    """Pictures of the free directions."""
    T = shown_pose(result)
    if T is None or not result.degenerate_directions:
        return []
    figures = [free_figure(base, target, T, free) for free in result.degenerate_directions]
    words = f"The data do not constrain the pose against {', '.join(d.words for d in result.degenerate_directions)}."
    return [page.Section("Free directions", [page.paragraph(words), page.figure_row(figures)])]


def _other_poses(
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
    if base is not None and survey is not None and not any(other.base for other in listed):
        drawn = [other.T_base_target for other in listed[:MAX_DRAWN_POSES]]
        blocks.append(page.figure_row([poses_figure(survey_of(base), survey, drawn)]))
    return [page.Section("Other poses", blocks)]


def _reproduced(result: RegistrationResult, command: str | None) -> page.Section:
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
