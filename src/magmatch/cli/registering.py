# SPDX-License-Identifier: BSD-3-Clause
"""What `register` and `demo` share: help in advance, the waiting time, and the result as text."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from magmatch.cli import STARTED
from magmatch.number_text import chance, deviations, many

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from magmatch.registration.result import RegistrationResult


def with_help() -> None:
    """If loops must be compiled first, let another process compile those of the search while this one makes maps."""
    from magmatch.compiled import FIRST_USE

    FIRST_USE.next_module = "magmatch.registration.register"


def with_wait(result: "RegistrationResult", loaded: float) -> "RegistrationResult":
    """Add the user's further waiting time to the result: loading the program and reading files."""
    now, seconds = perf_counter(), dict(result.seconds)
    reading = now - loaded - seconds.pop("total")
    return replace(result, seconds={"start": loaded - STARTED, "read": reading, **seconds, "total": now - STARTED})


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


def _motion(T: "RigidTransform", sd: tuple[float, float] | None) -> str:
    """Size of the motion, with its standard deviation if known."""
    import numpy as np

    text = f"turned by {np.rad2deg(T.rotation.magnitude()):.2f} deg, moved by {np.linalg.norm(T.translation):.3f} m"
    if sd is not None:
        text += f"; sd {deviations(*sd)} where the data constrain it best"
    return text


def _figures(result: "RegistrationResult") -> str:
    """Probability, overlap, residual and counts on one line."""
    parts = [] if result.probability is None else [f"probability {chance(result.probability)}"]
    parts += [f"overlap {result.overlap:.0%}"]
    parts += [] if result.residual is None else [f"normalised residual {result.residual:.2f}"]
    parts += [] if result.fitness is None else [f"fitness {result.fitness:.3g}"]
    parts += [f"{many(result.n_inliers, 'inlier')}, {result.n_correspondences} correspondences tried"]
    if not result.is_accepted and result.alternatives:
        parts += ["best candidate under 'alternatives' of the JSON"]
    return ", ".join(parts)
