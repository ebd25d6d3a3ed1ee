# SPDX-License-Identifier: BSD-3-Clause
"""Differences between two magnetometers: the target's bias and scale, estimated with the pose if the data require it.

The target's readings are corrected as ``b' = (I + D)^-1 (b - c)``, c the bias and D the scale (``s I``) or the full
soft-iron matrix. Both are constant in the target's survey frame, which is exact for a sensor with constant attitude
and an approximation otherwise. With a free bias, correlated map error would be mistaken for bias. Its prior is
therefore one of a few levels, and each wider one than the tightest pays beforehand (`prepared/model_prior.py`).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from magmatch.field.spline.spline_prior import CONSTANT_SD
from magmatch.settings import Settings
from magmatch.typing import Matrix, Vector3, Vectors

SensorMode = Literal["auto", "none", "bias", "scale", "full"]

# Prior standard deviation of what must not differ, T: rounding.
TIED_SD = float(np.sqrt(np.finfo(float).eps)) * CONSTANT_SD
# Prior standard deviations of the bias, T, tightest first: of one sensor, and of another that nobody calibrated.
BIAS_LEVELS = (0.05e-6, 3e-6)


class SensorConfig(Settings):
    """The differences that are allowed between the two magnetometers."""

    # 'auto': bias and scale, and soft iron, at the level that the evidence supports; 'none': identical sensors;
    # 'bias', 'scale' (and bias) and 'full' (soft iron and bias): free at the widest level.
    mode: SensorMode = "auto"


@dataclass(frozen=True, eq=False, slots=True)
class SensorModel:
    """Bias and gain of the target's magnetometer against the base's."""

    bias: np.ndarray  # (3,), T: target's axes
    gain: Matrix  # (3, 3): ``I + D``
    # (k, 3, 3): directions in which the gain may change; the parameters are the bias, then one number per shape
    shapes: np.ndarray

    @property
    def n_parameters(self) -> int:
        """Number of bias and gain parameters."""
        return 3 + len(self.shapes)

    @property
    def parameters(self) -> np.ndarray:
        """Bias, then the coefficient of each shape."""
        D = self.gain - np.eye(3)
        power = np.einsum("kij,kij->k", self.shapes, self.shapes)
        return np.concatenate([self.bias, np.einsum("kij,ij->k", self.shapes, D) / power])

    def correct(self, b: Vectors) -> Vectors:
        """Readings of the target as the base's sensor would have given them."""
        corrected: Vectors = np.linalg.solve(self.gain, (b - self.bias).T).T
        return corrected

    def half_way(self, residual: Vectors) -> Vectors:
        """Differences of readings as measured by a sensor half-way between the two: ``(I + D / 2) r``."""
        halved: Vectors = residual @ (np.eye(3) + self.gain).T / 2
        return halved

    def jacobian(self, middle: Vectors) -> np.ndarray:
        """Change of residuals half-way with the parameters: (n, 3, k), to first order in the gain.

        ``middle`` are the means of corrected and expected readings, (n, 3), T.
        """
        n = len(middle)
        bias = np.broadcast_to(-np.eye(3), (n, 3, 3))
        gain = -np.einsum("kij,nj->nik", self.shapes, middle)
        return np.concatenate([bias, gain], axis=2)

    def stepped(self, step: np.ndarray, limit: np.ndarray | float = np.inf) -> "SensorModel":
        """Return the model with its parameters moved, none beyond a limit."""
        parameters = np.clip(self.parameters + step, -np.asarray(limit), limit)
        gain = np.eye(3) + np.einsum("k,kij->ij", parameters[3:], self.shapes)
        return SensorModel(parameters[:3], gain, self.shapes)


def levels_to_try(mode: SensorMode) -> tuple[int, ...]:
    """Prior levels in the order they are tried.

    With 'auto', soft iron follows the widest level of bias and scale, if the sensors differ at all.
    """
    n = len(BIAS_LEVELS)
    return {"auto": tuple(range(n + 1)), "none": (-1,)}.get(mode, (n - 1,))


def identical_sensors(mode: SensorMode, level: int) -> SensorModel:
    """Start of the estimation: no difference, with the parameters that a level may change."""
    shapes = np.zeros((0, 3, 3))
    if mode == "full" or level >= len(BIAS_LEVELS):
        # Soft iron: all nine numbers of the gain are free.
        shapes = np.eye(9).reshape(9, 3, 3)
    elif mode in ("auto", "scale"):
        shapes = np.eye(3)[None]
    return SensorModel(np.zeros(3), np.eye(3), shapes)


def prior_sd(level: int, n_parameters: int, up: Vector3 | None = None) -> np.ndarray:
    """Prior standard deviations of the parameters at a level; a negative level ties them to zero.

    Where the vertical is known, no survey of a level carrier shows its sensor's bias along it.
    """
    if level < 0:
        return np.full(n_parameters, TIED_SD)
    bias = BIAS_LEVELS[min(level, len(BIAS_LEVELS) - 1)]
    biases = np.full(3, bias) if up is None else np.hypot(bias, BIAS_LEVELS[-1] * up)
    # In the strongest field, an error of scale is as large as the bias that goes with it.
    return np.concatenate([biases, np.full(n_parameters - 3, bias / CONSTANT_SD)])
