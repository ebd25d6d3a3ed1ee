# SPDX-License-Identifier: BSD-3-Clause
"""How well the base map explains the target's samples under a pose: what residual and overlap pictures show."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.registration.maps import survey_of
from magmatch.registration.result import RegistrationResult
from magmatch.typing import Indices, Mask, Points, Scalars, Vectors
from magmatch.viz.figures.plotting import thinned

# Normalised residual beyond which a sample is marked: of right ones, about 1 in 1000 (chi-square, three degrees).
LARGEST_ORDINARY = 2.33
MAX_COMPARED = 3000


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """Samples of the target against the base map; arrays in the base's frame."""

    rows: Indices  # (n,): which samples of the target these are
    positions: Points  # (n, 3), m
    # (n, 3), T: the target's vectors, turned, and corrected for the sensor where that was estimated
    measured: Vectors
    expected: Vectors  # (n, 3), T: the base map's prediction there, and its standard deviation
    expected_sd: Vectors  # (n, 3), T
    # (n,): length of the residual in its standard deviations: rms over samples is 1 where model and noise explain all
    normalised: Scalars
    is_known: Mask  # (n,): where the base map knows the field; nothing is said of the others

    @property
    def overlap(self) -> float:
        """Share of the samples in the known part of the base."""
        return float(self.is_known.mean())

    @property
    def typical(self) -> float | None:
        """Robust root mean square, from the median, as a result's ``residual`` is; None where nothing overlaps."""
        values = self.normalised[self.is_known]
        return float(np.median(values) / np.sqrt(chi2.median(3) / 3)) if len(values) else None

    @property
    def rms(self) -> float | None:
        """Root mean square of the normalised residual over the overlap, where bad samples count in full; or None."""
        values = self.normalised[self.is_known]
        return float(np.sqrt((values**2).mean())) if len(values) else None

    @property
    def is_large(self) -> Mask:
        """Samples in the overlap that differ by more than chance allows."""
        return np.asarray(self.is_known & (self.normalised > LARGEST_ORDINARY))


def compare(
    base: FieldMap,
    target: Survey | FieldMap,
    T_base_target: RigidTransform,
    result: RegistrationResult,
    n_compared: int = MAX_COMPARED,
) -> Comparison:
    """Put the target's samples into the base map."""
    survey = survey_of(target)
    noise = (base, target) if isinstance(target, FieldMap) else (base, base)
    variance = sum(m.hyperparameters.noise_sd**2 for m in noise)
    rows = thinned(len(survey), n_compared)
    p_base = transform_points(survey.positions[rows], T_base_target)
    measured = rotate_vectors(corrected(survey.field[rows], result), T_base_target)
    expected, spread = base.evaluate(p_base).field, base.covariance(p_base)
    r = measured - expected
    whitened = np.linalg.solve(spread + variance * np.eye(3), r[..., None])[..., 0]
    return Comparison(
        rows=rows,
        positions=p_base,
        measured=measured,
        expected=expected,
        expected_sd=np.sqrt(np.maximum(np.diagonal(spread, axis1=1, axis2=2), 0)),
        normalised=np.sqrt(np.maximum((r * whitened).sum(axis=1), 0) / 3),
        is_known=base.knows(p_base),
    )


def corrected(field: Vectors, result: RegistrationResult) -> Vectors:
    """Readings of the target as the base's sensor would give them, as far as the result says how they differ."""
    sensor = result.sensor or {}
    bias = np.asarray(sensor.get("bias") or np.zeros(3), dtype=np.float64)
    gain = np.asarray(sensor.get("gain") or (sensor.get("scale") or 1.0) * np.eye(3), dtype=np.float64)
    return np.asarray(np.linalg.solve(gain, (field - bias).T).T)
