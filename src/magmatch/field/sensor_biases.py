# SPDX-License-Identifier: BSD-3-Clause
"""Hard iron of each log of a map, solved with the field: three unknowns a log, in its sensor's axes.

With G the columns of the biases (each sample's sensor axes in the map's frame) and S the smoother of the map's fit,
the samples say ``G^T (I - S) G / s^2`` of the biases once the field is marginalised. So what no level walk shows by
itself, its vertical offset, is known from the other walks. What all logs share and no turn shows is left to the mean
field, whose prior is far wider than theirs. Along a path without orientations the sensor is taken to face where it
moves, as on a robot: the evidence tells whether it does. Samples without such an order have no bias.

Where a sensor hardly turns, errors of its orientations look like a bias. Let the field explain all but a share ``v``
of what a bias along some direction adds to the samples. Errors of variance ``a^2`` that are part of the turns then
read as a bias of ``a^2 / v`` times the field, and no bias along it is known better than that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.sensor_axes import stuck_axes
from magmatch.data.survey import Survey
from magmatch.data.units import field_text
from magmatch.field.folds import has_path_order
from magmatch.field.linear_model import FieldPosterior, Piece
from magmatch.field.selection.spline_evidence import integrated_autocorrelation_time
from magmatch.geometry import path_walked
from magmatch.typing import Indices, Mask, Matrix, Scalars, Tensors, Vector3, Vectors

# Of logs' biases, T: what a spread is chosen from, or that there is none. A phone that was never calibrated shows up
# to 30 uT.
SPREADS = (0.0, *np.geomspace(1e-7, 3e-5, 26).tolist())
# rad: errors of a moving sensor's orientations.
ATTITUDE_SD = 0.03
# The direction of travel is that from a point so far back on the path to one so far ahead: in steps, in extents.
CHORD = (3.0, 0.01)


@dataclass(frozen=True, eq=False, slots=True)
class SensorBiases:
    """Biases of the sensors of a map's logs, which were taken out of their readings.

    Attributes
    ----------
    bias, sd : (l, 3) arrays, T
        Of each of the map's surveys, in its sensor's axes (`sensor_axes`); 0 where it has none.
    spread : float, T
        Standard deviation of a component between logs: what another log of such sensors is expected to have.
    """

    bias: Vectors
    sd: Vectors
    spread: float

    def __post_init__(self) -> None:
        if self.bias.shape != self.sd.shape or self.bias.ndim != 2 or self.bias.shape[1] != 3:
            msg = f"expected three biases and their sd of each log, got {self.bias.shape} and {self.sd.shape}"
            raise ValueError(msg)
        if not (np.isfinite(self.bias).all() and np.isfinite(self.sd).all() and 0 <= self.spread < np.inf):
            msg = "expected finite biases and a spread that is not negative"
            raise ValueError(msg)

    def without(self, surveys: Sequence[Survey]) -> tuple[Survey, ...]:
        """The surveys as sensors without these biases had measured them."""
        return tuple(without_bias(survey, bias) for survey, bias in zip(surveys, self.bias, strict=True))

    def subset(self, surveys: Sequence[Survey], kept: Mask) -> "SensorBiases":
        """The biases of those surveys of which some samples are kept (a mask over all, in order)."""
        rows = np.unique(np.repeat(np.arange(len(surveys)), [len(survey) for survey in surveys])[kept])
        return replace(self, bias=self.bias[rows], sd=self.sd[rows])

    @property
    def in_words(self) -> str:
        """How large they are."""
        sizes = np.linalg.norm(self.bias, axis=1)
        if len(sizes) == 1:
            return f"Took a bias of {field_text(float(sizes[0]))}, which turns with the sensor, out of the log"
        middle, most = (field_text(float(size)) for size in (np.median(sizes), sizes.max()))
        return f"Took the sensor's bias out of each log: {middle} in the median, at most {most}"

    def facts(self, surveys: Sequence[Survey]) -> dict[str, Any]:
        """Each log's bias by name, plain numbers in T."""
        rows = zip(surveys, self.bias.tolist(), self.sd.tolist(), strict=True)
        logs = [{"name": survey.name, "bias": bias, "bias_sd": sd} for survey, bias, sd in rows]
        return {"sensor_bias_spread": self.spread, "sensor_biases": logs}


def solve_biases(
    posterior: FieldPosterior,
    R_model_map: Rotation,
    samples: Survey,
    surveys: Sequence[Survey],
    logs: Sequence[int],
    spread: float | None,
    n_alike: float = 1.0,
    attitude_sd: float = ATTITUDE_SD,
) -> SensorBiases:
    """Most likely biases of logs together with the field, given the fit of samples whose numbers a map has.

    ``samples``: of all surveys in the model's frame, as measured, whatever field the fit has seen at their places.
    ``logs``: numbers of the surveys whose bias is asked for (`biased_logs`); the others have none.
    ``spread``: of the biases (T), by default that which makes the samples likeliest.
    ``n_alike``: how many neighbouring samples share their errors, and so count as one (`shared_errors`).
    ``attitude_sd``: errors of orientations, rad.
    """
    found = no_biases(len(surveys), spread or 0.0)
    if not len(logs) or spread == 0:
        return found
    A, v = _said_by_all(posterior, R_model_map, samples, surveys, logs)
    variance = n_alike * posterior.hyperparameters.noise_sd**2
    # What is blended of tiles is not quite symmetric, and so may be less than nothing where nothing is said.
    values, vectors = np.linalg.eigh((A + A.T) / 2)
    values, counts = np.maximum(values, 0), np.repeat([len(surveys[k]) for k in logs], 3)
    size = float(np.sqrt((samples.field**2).sum(axis=1).mean()))
    turned = attitude_sd**2 * size * (counts @ vectors**2)
    # Zero where nothing is said.
    weights = np.divide(values, variance * values + turned**2, out=np.zeros_like(values), where=values > 0)
    precisions, along = weights * values, weights * (vectors.T @ v)
    chosen = _likeliest_spread(precisions, along) if spread is None else spread
    left = chosen**2 / (1 + chosen**2 * precisions)
    found.bias[logs] = (vectors @ (left * along)).reshape(-1, 3)
    found.sd[logs] = np.sqrt(vectors**2 @ left).reshape(-1, 3)
    return replace(found, spread=chosen)


def without_bias(survey: Survey, bias: Vector3) -> Survey:
    """The survey as measured by a magnetometer without the bias."""
    axes = sensor_axes(survey) if np.any(bias) else None
    return survey if axes is None else replace(survey, field=survey.field - axes.apply(bias))


def biased_logs(surveys: Sequence[Survey]) -> list[int]:
    """The logs that may have a bias: it turns with the sensor, so the sensor's axes must be known."""
    return [
        k
        for k, survey in enumerate(surveys)
        if (has_path_order(survey.positions) if survey.orientations is None else not stuck_axes(survey))
    ]


def sensor_axes(survey: Survey) -> Rotation | None:
    """Axes of the sensor in a survey's frame.

    Where no orientations are known, x is the direction of travel, and z is upright on the plane of the path, on the
    side to which the field points. None where samples follow no path either.
    """
    if survey.orientations is not None or not has_path_order(survey.positions):
        return survey.orientations
    frame = survey.principal_frame()
    if frame.rotation.inv().apply(survey.field.mean(axis=0))[2] < 0:
        # The sign that positions give it may change with the last few of them.
        frame *= RigidTransform.from_rotation(Rotation.from_rotvec([np.pi, 0, 0]))
    points, walked = frame.inv().apply(survey.positions), path_walked(survey.positions)
    # Over so much path that jitter turns nothing.
    step = np.median(np.diff(walked))
    reach = max(CHORD[0] * step, CHORD[1] * np.linalg.norm(np.ptp(points, axis=0)))
    behind, ahead = (np.column_stack([np.interp(walked + by, walked, x) for x in points.T]) for by in (-reach, reach))
    x, y, _ = (ahead - behind).T
    return frame.rotation * Rotation.from_euler("z", np.arctan2(y, x)[:, None])


def no_biases(n_logs: int, spread: float = 0.0) -> SensorBiases:
    """Give logs whose sensors have none their biases: zero."""
    return SensorBiases(np.zeros((n_logs, 3)), np.zeros((n_logs, 3)), spread)


def _said_by_all(
    posterior: FieldPosterior, R_model_map: Rotation, samples: Survey, surveys: Sequence[Survey], logs: Sequence[int]
) -> tuple[Matrix, Scalars]:
    """What all samples say of the biases of some logs, times the noise variance: precision, and its vector."""
    number = np.repeat(np.arange(len(surveys)), [len(survey) for survey in surveys])
    turns = np.zeros((len(samples), 3, 3))
    for k in logs:
        if (axes := sensor_axes(surveys[k])) is not None:
            turns[number == k] = (R_model_map * axes).as_matrix()
    A, v = np.zeros((3 * len(logs), 3 * len(logs))), np.zeros(3 * len(logs))
    for piece in posterior.pieces(samples.positions):
        seen = number[piece.rows]
        rows_of = [np.flatnonzero(seen == k) for k in logs]
        some = np.flatnonzero([len(rows) for rows in rows_of])
        if len(some):
            A_piece, v_piece = _said_by_one(piece, samples, turns, [rows_of[k] for k in some])
            at = (3 * some[:, None] + np.arange(3)).ravel()
            A[np.ix_(at, at)] += A_piece
            v[at] += v_piece
    return A, v


def _said_by_one(piece: Piece, samples: Survey, turns: Tensors, rows_of: list[Indices]) -> tuple[Matrix, Scalars]:
    """What the samples in one piece say, as `_said_by_all` has it.

    ``rows_of``: samples of each log, among those that the piece sees.
    """
    points, b, G = samples.positions[piece.rows], samples.field[piece.rows], turns[piece.rows]
    fit, w = piece.fit, piece.share
    E = [fit.loads(points[some], G[some]) for some in rows_of]
    # Of each sample its share in the answer: summed over the pieces, these are the residuals of the blend.
    shared = [fit.loads(points[some], w[some, None, None] * G[some]) for some in rows_of]
    explained = np.hstack(shared).T @ fit.solve(np.hstack([*E, fit.loads(points, b[:, :, None])]))
    of_fields = [np.einsum("n,nak,na->k", w[some], G[some], b[some]) for some in rows_of]
    counts = np.repeat([w[some].sum() for some in rows_of], 3)
    return np.diag(counts) - explained[:, :-1], np.concatenate(of_fields) - explained[:, -1]


def _likeliest_spread(values: Scalars, along: Scalars) -> float:
    """The spread under which the samples are likeliest, T, by what they say along independent directions."""
    evidence = [0.5 * (s**2 * along**2 / (1 + s**2 * values) - np.log1p(s**2 * values)).sum() for s in SPREADS]
    return float(SPREADS[int(np.argmax(evidence))])


def shared_errors(posterior: FieldPosterior, samples: Survey) -> float:
    """How many neighbouring samples of a fit share their errors: the autocorrelation time of its residuals."""
    residual = samples.field - posterior.evaluate(samples.positions).field
    return integrated_autocorrelation_time(residual, np.arange(len(samples)))
