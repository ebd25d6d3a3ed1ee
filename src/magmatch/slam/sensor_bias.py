# SPDX-License-Identifier: BSD-3-Clause
"""Hard iron, estimated from a log whose poses drift; it may jump where a phone recalibrates itself.

Along the path the field is a constant, turned as the odometry drifts, plus an independent smooth field in each part,
plus the bias rotated by the orientation: generalised least squares over all parts. Components that the headings do
not separate from the constant, such as the vertical of a carrier that leans alike, are left to the constant. How a
phone swings with each step separates nothing: what its attitude misses of the swing turns Earth's field.
"""

import logging
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from magmatch.data.sensor_axes import stuck_axes
from magmatch.data.survey import Survey
from magmatch.estimation.model_prior import HARD_IRON_SD
from magmatch.estimation.walk import bin_along_path, bin_means
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.geometry import path_walked
from magmatch.preparation.recalibrations import NO_CUTS, Recalibrations, find_recalibrations
from magmatch.preparation.sensor_log import SensorLog
from magmatch.slam.config import SlamConfig
from magmatch.slam.windows import PART_LENGTH
from magmatch.typing import Vector3

log = logging.getLogger(__name__)

# Bins a lengthscale.
BINS = 4


def recalibrations_of(survey: Survey) -> Recalibrations:
    """Find where the magnetometer recalibrated itself; none where orientations are missing or an axis is stuck."""
    if survey.orientations is None or stuck_axes(survey):
        return NO_CUTS
    return find_recalibrations(SensorLog.of(survey))


def in_one_calibration(survey: Survey, sample: int | None = None) -> Survey:
    """The survey with the calibration that the magnetometer had at a sample, by default for the longest time."""
    found = recalibrations_of(survey)
    if survey.orientations is None or not len(found):
        return survey
    log.info("%s: recalibrations of the magnetometer are taken out: %d", survey.name, len(found))
    return replace(survey, field=survey.orientations.apply(found.joined(SensorLog.of(survey), sample).readings))


def sensor_bias(survey: Survey, h: Hyperparameters, config: SlamConfig) -> tuple[Vector3, Vector3]:
    """Bias of the magnetometer in its own axes, and its sd, T; zero without orientations or with an axis stuck."""
    if survey.orientations is None or stuck_axes(survey):
        return np.zeros(3), np.zeros(3)
    turned = _headings_alone(survey.orientations) if config.is_gravity_aligned else survey.orientations
    rows = bin_along_path(np.ascontiguousarray(survey.positions), h.lengthscale / BINS)
    x, b, R = (bin_means(v, rows) for v in (survey.positions, survey.field, turned.as_matrix()))
    A, v = np.diag(np.repeat([HARD_IRON_SD**-2, 0.0], 3)), np.zeros(6)
    walked, drift = path_walked(x), config.odometry_of(survey.name)
    # A small turn of the axes, about each that drifts, is a change of the field across it.
    axes = np.eye(3)[2:] if config.is_gravity_aligned else np.eye(3)
    across = np.cross(axes, survey.field.mean(axis=0))
    parts = (walked / (PART_LENGTH * h.lengthscale)).astype(np.int64)
    for part in np.unique(parts):
        some = np.flatnonzero(parts == part)
        d, s = np.sqrt(5) * cdist(x[some], x[some]) / h.lengthscale, walked[some]
        C = h.signal_sd**2 * (1 + d + d * d / 3) * np.exp(-d) + h.noise_sd**2 * np.eye(len(some))
        turn = drift.rotation_sd**2 * np.minimum.outer(s, s) + drift.turn_rate_sd**2 * np.outer(s, s)
        factor = cho_factor(np.kron(np.eye(3), C) + np.kron(across.T @ across, turn), lower=True)
        # Component by component, as the covariance.
        J = np.hstack([np.swapaxes(R[some], 0, 1).reshape(-1, 3), np.repeat(np.eye(3), len(some), axis=0)])
        A = A + J.T @ cho_solve(factor, J)
        v = v + J.T @ cho_solve(factor, b[some].T.ravel())
    C = np.linalg.pinv(A, hermitian=True)
    return (C @ v)[:3], np.sqrt(np.diag(C)[:3])


def _headings_alone(R: Rotation) -> Rotation:
    """Orientations that turn about the vertical as these do, and lean as these do on average."""
    # Since the first: of a sensor that is upside down, the heading itself is not defined.
    z, w = (R * R[0].inv()).as_quat()[:, 2:].T
    about_z = Rotation.from_euler("z", 2 * np.arctan2(z, w)[:, None])
    return about_z * (about_z.inv() * R).mean()
