# SPDX-License-Identifier: BSD-3-Clause
"""The effect of each sensor error on the field of a survey: the columns of the least-squares problem."""

from collections.abc import Mapping

import numpy as np

from magmatch.preparation.least_squares import ParameterBlock
from magmatch.preparation.sensor_model import MISALIGNMENT_BASIS, SOFT_IRON_BASIS, SensorCorrection
from magmatch.typing import Scalars, Tensors, Vectors

CHANNEL = "channel "
# Channels that stand for pieces of a log, between jumps of its sensor's own calibration, begin with this.
PIECE = "recalibrated piece "


def sensor_blocks(R: Tensors, readings: Vectors, sizes: Mapping[str, float]) -> dict[str, ParameterBlock]:
    """Columns of the sensor's own errors."""
    columns = {}
    if "hard_iron" in sizes:
        columns["hard_iron"] = -np.moveaxis(R, 2, 0)
    for name, basis in (("soft_iron", SOFT_IRON_BASIS), ("misalignment", MISALIGNMENT_BASIS)):
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
    for name, basis in (("soft_iron", SOFT_IRON_BASIS), ("misalignment", MISALIGNMENT_BASIS)):
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
