# SPDX-License-Identifier: BSD-3-Clause
"""Correction of a magnetometer, ``b_true = M b_read - d`` in the sensor's frame, and of its clock.

What a unit of each error changes in the field of a survey is a column of the least-squares problem.

A correction is written only if it leaves a field that the readings can be of. What a sensor adds turns with it, so it
makes the field and its magnitude vary with the attitude. A right correction takes that off: neither varies more along
the path than as read. Magnitudes need no attitude, so wrong poses cannot make a wrong correction look right. What is
allowed beyond is what soft iron may be at most.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.units import ORDINARY_FIELD, field_text
from magmatch.geometry import GENERATORS
from magmatch.preparation.least_squares import ParameterBlock
from magmatch.typing import Matrix, Scalars, Tensors, Vector3, Vectors

CHANNEL = "channel "
# Channels that stand for pieces of a log, between jumps of its sensor's own calibration, begin with this.
PIECE = "recalibrated piece "
# Symmetric matrices without trace (the trace would be a common scale, which no survey alone can tell from a stronger
# field). Coefficients are entries: half the difference of xx and yy, then zz, xy, xz and yz.
SOFT_IRON_BASIS = np.array([np.diag([1.0, -1.0, 0.0]), np.diag([-0.5, -0.5, 1.0]), *np.abs(GENERATORS[::-1])])
# Soft iron and unequal gains are 5 % or so. At six times that the weakest axis still has two thirds of its gain, far
# from a singular matrix, under which any field is consistent.
MOST_SOFT_IRON = 0.3
# rad: beyond, a misalignment is not linear enough.
MOST_TURN = 0.6
# Standard deviation of each error beforehand (T, a share, rad): phones and robots show tens of uT of hard iron, gains
# a few per cent, mounting a few degrees. What the data do not tell stays at 0, not at this.
EXPECTED_SD = {"hard_iron": 50e-6, "soft_iron": 0.05, "misalignment": 0.1}
# Share of the field that noise may add to its spread.
NOISE = 0.01


@dataclass(frozen=True, eq=False, slots=True)
class SensorCorrection:
    """Correction of a sensor and its clock."""

    # (3, 3): M, sensor frame; without a common scale, which a survey alone cannot tell
    matrix: Matrix = field(default_factory=lambda: np.eye(3))
    shift: Vector3 = field(default_factory=lambda: np.zeros(3))  # (3,), T: d, sensor frame
    time_offset: float = 0.0  # s: to be added to the magnetometer's times to have those of the poses
    # Each (3,): what each channel adds to the corrected field, T per unit of the channel, sensor frame
    currents: Mapping[str, Vector3] = field(default_factory=dict)

    @classmethod
    def from_dict(cls, content: Any) -> "SensorCorrection":
        """Matrix and shift as a file holds them; ValueError where they are none."""
        with suppress(KeyError, TypeError, ValueError):
            matrix, shift = (np.array(content[name], dtype=np.float64) for name in ("matrix", "shift"))
            is_one = matrix.shape == (3, 3) and shift.shape == (3,) and bool(np.isfinite([*matrix, shift]).all())
            if is_one and 0.1 < abs(np.linalg.det(matrix)) < 10:
                return cls(matrix, shift)
        msg = "expected matrix, 3x3 near the identity, and shift, 3 numbers"
        raise ValueError(msg)

    def as_dict(self) -> dict[str, Any]:
        """Matrix and shift, ready for JSON: what holds for any log of the sensor."""
        return {"matrix": self.matrix.tolist(), "shift": self.shift.tolist()}

    @property
    def is_identity(self) -> bool:
        """Whether it changes nothing."""
        is_plain = np.array_equal(self.matrix, np.eye(3)) and not self.shift.any() and self.time_offset == 0
        return bool(is_plain and not self.currents)

    @property
    def hard_iron(self) -> Vector3:
        """The constant part of the readings, ``c = M^-1 d``: (3,), T, sensor frame."""
        return np.asarray(np.linalg.solve(self.matrix, self.shift))

    @property
    def soft_iron(self) -> Matrix:
        """The matrix that multiplies the field before it is read, ``A = M^-1`` scaled to determinant 1."""
        A = np.linalg.inv(self.matrix)
        return np.asarray(A / np.cbrt(np.linalg.det(A)))

    @property
    def misalignment(self) -> Vector3:
        """Turn of the sensor against the poses' frame: rotation vector of the soft iron's rotation, (3,), rad."""
        u, _, vt = np.linalg.svd(self.soft_iron)
        return np.asarray(Rotation.from_matrix(u @ vt).as_rotvec())

    def after(self, first: "SensorCorrection") -> "SensorCorrection":
        """Correction that makes another one first; this one's clock and currents hold."""
        return replace(
            self, matrix=self.matrix @ first.matrix, shift=np.asarray(self.matrix @ first.shift + self.shift)
        )

    def corrected(self, readings: Vectors, channels: Mapping[str, np.ndarray] | None = None) -> Vectors:
        """True field of readings (T, sensor frame), less what the channels in `currents` add."""
        field_sensor: Vectors = readings @ self.matrix.T - self.shift
        for name, coefficient in self.currents.items():
            if channels is not None and name in channels:
                field_sensor = field_sensor - channels[name][:, None] * coefficient
        return field_sensor


def sensor_blocks(R: Tensors, readings: Vectors, sizes: Mapping[str, float]) -> dict[str, ParameterBlock]:
    """Columns of the sensor's own errors."""
    columns = {}
    if "hard_iron" in sizes:
        columns["hard_iron"] = -np.moveaxis(R, 2, 0)
    for name, basis in (("soft_iron", SOFT_IRON_BASIS), ("misalignment", GENERATORS)):
        if name in sizes:
            columns[name] = np.einsum("nij,kjl,nl->kni", R, basis, readings, optimize=True)
    return {name: ParameterBlock(values, sizes[name]) for name, values in columns.items()}


def channel_blocks(R: Tensors, channels: Mapping[str, Scalars], size: float) -> dict[str, ParameterBlock]:
    """Columns of disturbances that follow other channels: ``-R k I``, per standard deviation of the channel."""
    blocks = {}
    for name, values in channels.items():
        spread = float(values.std())
        if spread > 1e-9 * max(float(np.abs(values).max(initial=0.0)), 1e-300):
            columns = -np.moveaxis(R, 2, 0) * ((values - values.mean()) / spread)[:, None]
            blocks[CHANNEL + name] = ParameterBlock(columns, size)
    return blocks


def model_of(estimate: Mapping[str, np.ndarray], channels: Mapping[str, Scalars]) -> SensorCorrection:
    """Sensor model of the estimated unknowns; what was not estimated is taken to be perfect."""
    matrix, shift = np.eye(3), np.zeros(3)
    for name, basis in (("soft_iron", SOFT_IRON_BASIS), ("misalignment", GENERATORS)):
        if name in estimate:
            matrix = matrix + np.einsum("k,kij->ij", estimate[name], basis)
    if "hard_iron" in estimate:
        shift = shift + estimate["hard_iron"]
    currents = {}
    for name, values in channels.items():
        if CHANNEL + name in estimate:
            currents[name] = estimate[CHANNEL + name] / values.std()
            shift = shift - currents[name] * values.mean()
    offset = float(estimate["time_offset"][0]) if "time_offset" in estimate else 0.0
    return SensorCorrection(matrix, shift, offset, currents)


def why_no_sensor(model: SensorCorrection) -> str:
    """Say why no sensor has such errors; nothing where one may."""
    # Rotations aside: stretches of a matrix without a common scale.
    stretch = np.linalg.svd(model.matrix, compute_uv=False)
    worst = float(np.abs(stretch - 1).max())
    if worst > MOST_SOFT_IRON:
        return f"a soft iron of {worst:.0%} is more than the {MOST_SOFT_IRON:.0%} that a sensor that works may have"
    turn = float(np.linalg.norm(model.misalignment))
    if turn > MOST_TURN:
        most = f"{np.degrees(MOST_TURN):.0f} deg"
        found = f"a misalignment of {np.degrees(turn):.0f} deg"
        return f"{found} is more than the {most} that can be told: state the axes"
    return ""


def why_no_field(as_read: Vectors, corrected: Vectors) -> str:
    """Say why a corrected field, (n, 3), T, survey frame, is none that the readings can be of; else nothing."""
    read, left = np.linalg.norm(as_read, axis=1), np.linalg.norm(corrected, axis=1)
    median = float(np.median(read)), float(np.median(left))
    low, high = ORDINARY_FIELD
    if low <= median[0] <= high and not low <= median[1] <= high:
        return f"the median magnitude would go from {field_text(median[0])} to {field_text(median[1])}"
    spreads = {"the magnitude": (read.std(), left.std())}
    spreads["the field"] = np.sqrt(as_read.var(axis=0).sum()), np.sqrt(corrected.var(axis=0).sum())
    for name, (before, after) in spreads.items():
        if after > np.hypot((1 + MOST_SOFT_IRON) * before, NOISE * median[0]):
            more = f"more along the path, from {field_text(float(before))} to {field_text(float(after))}"
            return f"{name} would vary {more}: errors of a sensor make it vary, not their removal"
    return ""
