# SPDX-License-Identifier: BSD-3-Clause
"""Summaries of results and files as text."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magmatch.number_text import told

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from magmatch.registration.result import RegistrationResult


def tell_result(
    result: "RegistrationResult", out: Path | None = None, report: Path | None = None, figures: Path | None = None
) -> str:
    """Summarise a registration in a few lines."""
    from magmatch.glossary import terms_in
    from magmatch.registration.sensor_calibration import in_words as calibration_words

    lines = [f"{'Accepted' if result.is_accepted else f'Not accepted ({result.status})'}: {result.reason}"]
    jargon = [term.lower() for term in terms_in(result.reason)]
    lines += [f"('magmatch glossary' explains {', '.join(jargon)})"] if jargon else []
    lines += [] if result.base is None else [f"Map: {result.base}"]
    if (T := result.T_base_target) is not None:
        lines += ["T_base_target (p_base = T p_target, metres):"]
        lines += ["  " + " ".join(f"{v:12.6f}" for v in row) for row in T.as_matrix()]
        lines += [f"  {_motion(T, result.standard_deviations)}"]
    lines += [_figures(result)]
    lines += [f"Sensor of the {side} calibrated: {words}" for side, words in calibration_words(result.sensor).items()]
    lines += [f"Free direction: {d.words}" for d in result.degenerate_directions]
    if result.seconds:
        stages = ", ".join(f"{name} {s:.2f}" for name, s in result.seconds.items() if name != "total")
        lines += [f"Took {result.seconds.get('total', 0.0):.2f} s ({stages})"]
    lines += [f"Wrote the result to {out}"] if out else []
    lines += [f"Wrote the report to {report}"] if report else []
    lines += [f"Wrote figures into {figures}"] if figures else []
    return "\n".join(lines)


def info_table(facts: Mapping[str, Any]) -> str:
    """Format nested facts as aligned lines."""
    rows = list(_rows(facts))
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:{width}}  {text}" for name, text in rows)


# Units of the facts that `info` shows, by name.
UNITS = {
    "pose_sd": "m", "low": "m", "high": "m", "extent": "m", "path_length": "m", "median_step": "m",
    "median_magnitude": "uT", "smallest_magnitude": "uT", "largest_magnitude": "uT", "mean": "uT", "sd": "uT",
    "first": "s", "last": "s", "duration": "s", "rate": "Hz", "longest_gap": "s",
    "sensor_bias_spread": "uT", "lengthscale": "m", "spacing": "m", "signal_sd": "uT", "noise_sd": "uT",
    "spline": "uT", "divergence_free": "uT", "curl_free": "uT", "harmonic": "uT",
}  # fmt: skip


def _rows(facts: Mapping[str, Any], above: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for name, value in facts.items():
        label = (above + name).replace("_", " ")
        if isinstance(value, Mapping):
            rows += _rows(value, f"{above}{name} ")
        elif name == "topics":
            rows += [("topic", _topic_text(topic)) for topic in value] or [("topics", "none")]
        elif name == "sensor_biases":
            rows += [
                (f"bias of {one['name']}", f"{_text(one['bias'], 'uT')} (sd {_text(one['bias_sd'], 'uT')})")
                for one in value
            ]
        elif name == "warnings":
            rows += [("warning", str(w)) for w in value] or [("warnings", "none")]
        else:
            # Seconds since 1970 have ten digits before the point.
            is_moment = above.endswith("time ") and name in {"first", "last"} and value is not None
            rows.append((label, f"{value:.3f} s" if is_moment else _text(value, UNITS.get(name, ""))))
    return rows


def _topic_text(topic: Mapping[str, Any]) -> str:
    """One line of a log's contents."""
    text = f"{topic['name']}  {topic['type']}  {topic['count']} messages"
    if topic["rate"] is not None:
        text += f", {topic['rate']:.4g} Hz, {topic['span'][1] - topic['span'][0]:.6g} s"
    return text


def _text(value: Any, unit: str) -> str:
    match value:
        case None:
            return "none"
        case bool():
            return "yes" if value else "no"
        case list():
            return ", ".join(_text(v, "") if unit != "uT" else f"{1e6 * v:.4g}" for v in value) + f" {unit}".rstrip()
        case float():
            # To a thousandth, however large: coordinates far from their origin.
            return f"{told(1e6 * value if unit == 'uT' else value, 6, 1e-3)} {unit}".rstrip()
    return f"{value} {unit}".rstrip()


def _motion(T: "RigidTransform", sd: tuple[float, float] | None) -> str:
    """Size of the motion, with its standard deviation if known."""
    import numpy as np

    text = f"turned by {np.rad2deg(T.rotation.magnitude()):.2f} deg, moved by {np.linalg.norm(T.translation):.3f} m"
    if sd is not None:
        turn, shift = sd
        text += f"; sd {np.rad2deg(turn):.2f} deg, {1e3 * shift:.1f} mm where the target lies"
    return text


def _figures(result: "RegistrationResult") -> str:
    """Probability, overlap, residual and counts on one line."""
    parts = [] if result.probability is None else [f"probability {_probability(result.probability)}"]
    parts += [f"overlap {result.overlap:.0%}"]
    parts += [] if result.residual is None else [f"normalised residual {result.residual:.2f}"]
    parts += [] if result.fitness is None else [f"fitness {result.fitness:.3g}"]
    parts += [f"{result.n_inliers} inliers of {result.n_correspondences} correspondences"]
    if not result.is_accepted and result.alternatives:
        parts += ["best candidate under 'alternatives' of the JSON"]
    return ", ".join(parts)


def _probability(value: float) -> str:
    """Three digits, never rounded to certainty."""
    if value < 0.001:
        return "below 0.001"
    if value > 0.999:
        return "above 0.999"
    return f"{value:.3f}"
