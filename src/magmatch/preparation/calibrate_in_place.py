# SPDX-License-Identifier: BSD-3-Clause
"""Hard and soft iron of a sensor that was rotated in one place: its readings lie on an ellipsoid."""

from collections.abc import Mapping

import numpy as np

from magmatch.data.sensor_axes import find_repeats, find_stuck
from magmatch.errors import SurveyError
from magmatch.estimation.gauss_newton import student_weights
from magmatch.preparation.least_squares import MEDIAN_TO_SD, MOST_STEPS, ParameterBlock, Solution, System
from magmatch.preparation.sensor_model import (
    EXPECTED_SD,
    SOFT_IRON_BASIS,
    SensorCorrection,
    model_of,
    why_no_field,
    why_no_sensor,
)
from magmatch.typing import Matrix, Scalars, Vector3, Vectors

FEWEST_READINGS = 50
CONVERGED = 1e-10  # T
# Rounds of the first centre, and the misfit left out there, in the median one: one huge spike would carry it away.
TRIMMED, WIDEST = 5, 4.0
# Spread of |b| after the fit, relative to its mean: more than this is no one field seen from many sides.
WORST_FIT = 0.1


def fit_ellipsoid(readings: Vectors) -> tuple[SensorCorrection, Solution]:
    """Correction that gives all readings of a sensor, rotated in one place, the same magnitude (sensor frame, T).

    The correction is zero along directions that the attitudes do not determine: unless the sensor is turned upside
    down, one axis of the hard iron and parts of the soft iron stay unknown. Magnitudes never determine a
    misalignment.

    Gauss-Newton on ``|(I + N) b - d| - r`` with Student weights; r, the local field strength, is free. N is symmetric
    without trace, since scale and strength cannot be told apart.
    """
    if (n_new := int((~find_repeats(readings)).sum())) < FEWEST_READINGS:
        msg = f"expected at least {FEWEST_READINGS} different readings of a sensor turned about, got {n_new}"
        raise SurveyError(msg)
    center, weights = _sphere(readings)
    model = SensorCorrection(shift=center)
    values = {"hard_iron": model.shift, "soft_iron": np.zeros(5)}
    for _ in range(MOST_STEPS):
        corrected = model.corrected(readings)
        magnitude = np.linalg.norm(corrected, axis=1)
        u = corrected / magnitude[:, None]
        columns = {"hard_iron": -u.T, "soft_iron": np.einsum("ni,kij,nj->kn", u, SOFT_IRON_BASIS, readings)}
        y = magnitude - sum(values[name] @ columns[name] for name in columns)
        blocks = {name: ParameterBlock(column[..., None], EXPECTED_SD[name]) for name, column in columns.items()}

        def project(c: np.ndarray, w: np.ndarray = weights) -> tuple[np.ndarray, np.ndarray]:
            left = c * w[:, None]
            return left, np.asarray(c - (left.sum(axis=1) / w.sum())[:, None])

        by_noise = _noise_products(u, magnitude, readings, model, values, weights)
        solution = System.of(y[:, None], blocks, project, by_noise).solve(blocks)
        before, values, model = model, dict(solution.estimate), model_of(solution.estimate, {})
        weights = student_weights((solution.free[:, 0] / solution.noise_sd) ** 2, 1)
        if np.abs(model.shift - before.shift).max() < CONVERGED:
            break
    _require_sensor(readings, model, solution)
    return model, solution


def _noise_products(
    u: Vectors, magnitude: Scalars, readings: Vectors, model: SensorCorrection, values: Mapping[str, np.ndarray],
    weights: Scalars,
) -> Matrix:  # fmt: skip
    """What noise of variance 1 in the readings adds to the products of all columns and of y: (9, 9)."""
    # du / db = (I - u u') M / |c|, by which the columns -u and u' B b change with the reading b.
    turn = (np.eye(3) - u[:, :, None] * u[:, None, :]) @ model.matrix / magnitude[:, None, None]
    along = np.einsum("kij,nj->kni", SOFT_IRON_BASIS, readings)
    soft = np.einsum("kni,nij->knj", along, turn) + np.einsum("ni,kij->knj", u, SOFT_IRON_BASIS)
    slopes = np.concatenate([-np.moveaxis(turn, 1, 0), soft])
    of_y = u @ model.matrix - np.einsum("k,kni->ni", np.concatenate([*values.values()]), slopes)
    slopes = np.concatenate([slopes, of_y[None]])
    return np.asarray(np.einsum("n,kni,lni->kl", weights, slopes, slopes, optimize=True))


def _sphere(readings: Vectors) -> tuple[Vector3, Scalars]:
    """Begin the iteration: a centre, ``|b|^2 = 2 c.b + k`` by least trimmed squares, and weights about it."""
    A = np.column_stack([2 * readings, np.full(len(readings), 1e-5)])
    square, misfit = (readings**2).sum(axis=1), np.linalg.norm(readings - np.median(readings, axis=0), axis=1)
    for _ in range(TRIMMED):
        rows = misfit <= WIDEST * np.median(misfit)
        center = np.linalg.lstsq(A[rows], square[rows], rcond=1e-3)[0][:3]
        distance = np.linalg.norm(readings - center, axis=1)
        misfit = np.abs(distance - np.median(distance))
    return np.asarray(center), student_weights((misfit / (MEDIAN_TO_SD * np.median(misfit))) ** 2, 1)


def _require_sensor(readings: Vectors, model: SensorCorrection, solution: Solution) -> None:
    """Refuse a correction that no sensor needs, or that leaves no one field."""
    corrected = model.corrected(readings)
    # The axis that a sensor was turned about reads one value, too: its offset stays open.
    stuck = [axis for axis in find_stuck(readings) if not solution.is_open["hard_iron"][axis]]
    why = f"the sensor's {'xyz'[stuck[0]]} axis is stuck or at the end of its range" if stuck else ""
    magnitude = np.linalg.norm(corrected, axis=1)
    misfit = MEDIAN_TO_SD * float(np.median(np.abs(magnitude - np.median(magnitude)))) / float(np.median(magnitude))
    unfit = f"no ellipsoid fits: the magnitude still varies by {misfit:.0%} after the correction"
    why = why or why_no_sensor(model) or why_no_field(readings, corrected) or (unfit if misfit > WORST_FIT else "")
    if why:
        msg = f"{why}; turn the sensor about in one place, away from steel"
        raise SurveyError(msg)
