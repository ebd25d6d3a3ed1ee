# SPDX-License-Identifier: BSD-3-Clause
"""Whether part of the readings turns with the sensor: a test fast enough for every survey that is registered."""

from dataclasses import replace

import numpy as np

from magmatch.data.frame_mistakes import N_ASKED, N_PARTS
from magmatch.data.survey import Survey
from magmatch.field.folds import has_path_order
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_evidence import integrated_autocorrelation_time
from magmatch.field.subset import choose_part
from magmatch.field.tiles.region_model import fit_operations
from magmatch.preparation.consistency import MapConsistency
from magmatch.preparation.sensor_model import EXPECTED_SD
from magmatch.threads import single_threaded
from magmatch.typing import Indices, Points

# Samples that are asked: through the survey where a map of that costs no more operations, else around a few places,
# else with wider splines.
CUTS, WIDER, MOST_OPERATIONS = (1, 2), 1.5 ** np.arange(4), 4e9
# Nats for one direction of the sensor's frame that are worth a calibration, which has the last word. Error-free logs
# stay below 0; hard iron of 1.5 to 30 uT reaches 4 to 95 where places are passed more than once.
MIN_EVIDENCE = 3.0


@single_threaded
def offset_evidence(survey: Survey, hyperparameters: Hyperparameters) -> float:
    """Measure how much better a constant in the sensor's frame, beside a map of the place, explains the readings.

    With c the columns of the orientations' matrices, P what no map explains of them, s the noise and k how many
    samples count as one, the offset's information is ``A = c'Pc / (k s^2)`` and its score ``g = c'Py / (k s^2)``.
    Along an eigenvector v of A with eigenvalue a, an offset of prior deviation d changes the log evidence by
    ``(v'g)^2 / (2 (a + d^-2)) - ln(1 + a d^2) / 2``. Each direction is asked by itself: of a sensor that turns about
    one axis two are told and the third is not.
    """
    if survey.orientations is None:
        return -np.inf
    samples = survey.transformed(survey.principal_frame().inv())
    asked = _asked(samples.positions, hyperparameters)
    if asked is None:
        return -np.inf
    rows, h = asked
    part = samples.subset(rows)
    assert part.orientations is not None  # those of the survey
    columns = np.moveaxis(part.orientations.as_matrix(), 2, 0)
    try:
        consistency = MapConsistency(part.positions, h, np.ones(len(part)))
    except np.linalg.LinAlgError:
        return -np.inf  # numbers so extreme that their map of fewer samples is lost in rounding
    left, right = consistency.project(np.concatenate([columns, part.field[None]]))
    residual = right[-1]
    # Thinned samples are neighbours along the path all the same.
    places = rows // int(np.diff(rows).min(initial=len(survey)))
    together = integrated_autocorrelation_time(residual, places) if has_path_order(part.positions) else 1.0
    noise = together * max(h.noise_sd**2, float((residual**2).mean()))
    products = np.einsum("inc,jnc->ij", left[:3], right) / noise
    values, vectors = np.linalg.eigh((products[:, :3] + products[:, :3].T) / 2)
    scores, precision = vectors.T @ products[:, 3], EXPECTED_SD["hard_iron"] ** -2
    gains = scores**2 / (2 * (np.maximum(values, 0) + precision)) - np.log1p(np.maximum(values, 0) / precision) / 2
    return float(gains.max())


def _asked(points: Points, h: Hyperparameters) -> tuple[Indices, Hyperparameters] | None:
    """Rows of samples, and splines over them, coarse enough for a map in little time.

    Passes of one place with other headings are what tells: closer splines are given up before those are.
    """
    rows = [np.arange(0, len(points), -(-len(points) // N_ASKED))]
    rows += [np.flatnonzero(choose_part(points, min(N_ASKED, len(points)) // cut, N_PARTS)) for cut in CUTS]
    tried = ((some, replace(h, spacing=wider * h.spacing)) for wider in WIDER for some in rows)
    return next((t for t in tried if fit_operations(points[t[0]], t[1]) <= MOST_OPERATIONS), None)
