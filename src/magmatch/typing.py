# SPDX-License-Identifier: BSD-3-Clause
"""Array aliases: float64, rows are things, shapes checked in tests only."""

import numpy as np
from jaxtyping import Bool, Float64, Int64

Scalars = Float64[np.ndarray, " n"]
Points = Float64[np.ndarray, "n 3"]  # positions, m
Vectors = Float64[np.ndarray, "n 3"]  # field values, T
Tensors = Float64[np.ndarray, "n 3 3"]  # [i, a, b] = dB_a / dx_b, T/m
ThirdOrder = Float64[np.ndarray, "n 3 3 3"]  # [i, a, b, c] = d2 B_a / dx_b dx_c, T/m^2
Mask = Bool[np.ndarray, " n"]
Indices = Int64[np.ndarray, " n"]
Vector3 = Float64[np.ndarray, "3"]
Matrix = Float64[np.ndarray, "m k"]
Covariance6 = Float64[np.ndarray, "6 6"]  # rotation first: rad, m

# The same as fields of records.
VECTOR, ROTATION, POSE, COVARIANCE = (np.dtype(("f8", shape)) for shape in ((3,), (3, 3), (4, 4), (6, 6)))
