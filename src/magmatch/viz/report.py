# SPDX-License-Identifier: BSD-3-Clause
"""The report of a registration: the verdict in words, the pictures, and what it takes to run it again."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.registration.result import RegistrationResult
from magmatch.viz.page import details, figure_row, heading, paragraph, table, verdict, write_page
from magmatch.viz.registration_figures import scene_figures, slice_figures


def write_report(
    path: str | Path, base: Survey | FieldMap | None, target: Survey | FieldMap | None, result: RegistrationResult
) -> None:
    """Write one HTML page about a registration; it works offline and on a phone.

    Parameters
    ----------
    path : path
        Where; an existing file is replaced once the new one is complete.
    base, target : Survey or FieldMap, optional
        What was registered, each in its own frame. Slices are drawn where both are maps, nothing is drawn where
        one is missing.
    result : RegistrationResult

    Raises
    ------
    MissingExtraError
        Plotly is not installed.
    """
    sections = [_verdict(result), '<div class="columns"><div>', _figures(result), "</div><div>", _transform(result)]
    sections += ["</div></div>"]
    if base is not None and target is not None:
        base_survey, target_survey = _survey(base), _survey(target)
        sections += [heading("Both surveys in space"), figure_row(scene_figures(base_survey, target_survey, result))]
        if isinstance(base, FieldMap) and isinstance(target, FieldMap):
            sections += [
                heading("The field of both maps"),
                paragraph("One colour scale for both maps. Blank: the map has no samples nearby."),
                figure_row(slice_figures(base, target, result)),
            ]
    sections += [*_certainty(result), *_again(result)]
    write_page(path, _title(result), sections)


def _survey(read: Survey | FieldMap) -> Survey:
    return read.survey if isinstance(read, FieldMap) else read


def _title(result: RegistrationResult) -> str:
    names = [str(entry.get("name", "?")) for entry in result.inputs]
    return f"magmatch: {names[1]} in the frame of {names[0]}" if len(names) == 2 else "magmatch: registration"


def _verdict(result: RegistrationResult) -> str:
    words = "Accepted" if result.is_accepted else f"Not accepted: {result.status.replace('_', ' ')}"
    if result.probability is not None:
        words += f" (probability of being right {result.probability:.3f})"
    return verdict(words, result.reason, is_good=result.is_accepted)


def _figures(result: RegistrationResult) -> str:
    """What there is to know in numbers."""
    rows = [["Overlap", f"{result.overlap:.0%} of the target's samples"]]
    if result.residual is not None:
        rows.append(["Normalised residual", f"{result.residual:.2f} (1: model and noise explain all)"])
    if result.fitness is not None:
        rows.append(["Fitness", f"{result.fitness:.3g} (cross product of aligned vectors)"])
    matches = f"{result.n_inliers} inliers of {result.n_correspondences} correspondences"
    rows.append(["Matches", f"{matches}, {result.n_keypoints} keypoints"])
    rows += _sensor(result.sensor or {})
    rows += [["Free direction", d.words] for d in result.degenerate_directions]
    stages = ", ".join(f"{name} {s:.2f}" for name, s in result.seconds.items() if name != "total")
    rows.append(["Seconds", f"{result.seconds.get('total', 0.0):.2f} ({stages})"])
    return table(rows)


def _transform(result: RegistrationResult) -> str:
    """The motion, or what there is instead of it."""
    T = result.T_base_target
    if T is None:
        return paragraph("No transform is given, since none was accepted.")
    rows = [
        ["Turned by", _angle(T)],
        ["Moved by", ", ".join(f"{t:.4f}" for t in T.translation) + " m"],
    ]
    matrix = [[name, *(f"{v:.5f}" for v in row)] for name, row in zip("xyz1", T.as_matrix(), strict=True)]
    words = paragraph("T_base_target, with p_base = T_base_target p_target:")
    return table(rows) + words + table(matrix, ["", "x", "y", "z", "shift (m)"])


def _certainty(result: RegistrationResult) -> list[str]:
    """Error bars and rival poses."""
    sections: list[str] = []
    if result.covariance is not None:
        sd = np.sqrt(np.diag(result.covariance))
        axes = ["about x", "about y", "about z", "origin along x", "origin along y", "origin along z"]
        text = [f"{np.rad2deg(s):.3f} deg" for s in sd[:3]] + [f"{1e3 * s:.1f} mm" for s in sd[3:]]
        rows = [[axis, words] for axis, words in zip(axes, text, strict=True)]
        turn, shift = result.standard_deviations or (0.0, 0.0)
        rows.insert(0, ["where the target lies", f"{np.rad2deg(turn):.3f} deg, {1e3 * shift:.1f} mm"])
        sections += [heading("Standard deviations, in the target's axes"), table(rows)]
    if result.alternatives:
        rows = [
            [str(k + 1), "-" if a.probability is None else f"{a.probability:.3f}", _angle(a.T_base_target),
             ", ".join(f"{t:.3f}" for t in a.T_base_target.translation)]
            for k, a in enumerate(result.alternatives)
        ]  # fmt: skip
        sections += [heading("Other poses"), table(rows, ["", "probability", "turned by", "moved by (m)"])]
    return sections


def _again(result: RegistrationResult) -> list[str]:
    """All it takes to get the same numbers again."""
    inputs = [
        [str(entry.get("name", "?")), str(entry.get("sha256", entry.get("SHA-256", "")))] for entry in result.inputs
    ]
    config = json.dumps(result.config, indent=2)
    return [
        heading("To run it again"),
        paragraph(f"magmatch {result.version}, seed {result.seed}. These settings, saved to a file, go to --config."),
        table(inputs, ["input", "SHA-256"]) if inputs else "",
        details("Settings", config),
    ]


def _angle(T: RigidTransform) -> str:
    vector = T.rotation.as_rotvec()
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return "0.00 deg"
    return f"{np.rad2deg(angle):.2f} deg about ({', '.join(f'{c:.2f}' for c in vector / angle)})"


def _sensor(sensor: Mapping[str, Any]) -> list[list[str]]:
    """What differs between the two magnetometers, where it was estimated."""
    rows = []
    if sensor.get("bias") is not None:
        rows.append(["Sensor bias", ", ".join(f"{1e9 * b:.0f}" for b in sensor["bias"]) + " nT"])
    if sensor.get("scale") is not None:
        rows.append(["Sensor scale", f"{sensor['scale']:.4f}"])
    return rows
