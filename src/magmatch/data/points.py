# SPDX-License-Identifier: BSD-3-Clause
"""Points and grids for ParaView and its kin: PLY and legacy VTK, binary, double precision."""

from collections.abc import Mapping
from typing import BinaryIO

import numpy as np

from magmatch.number_text import exact
from magmatch.typing import Points, Scalars, Vector3

AXES = "xyz"


def write_ply(stream: BinaryIO, points: Points, values: Mapping[str, np.ndarray]) -> None:
    """Write points (m) with numbers at each as PLY; a vector ``b`` becomes the properties ``bx, by, bz``."""
    columns = dict(zip(AXES, points.T, strict=True))
    for name, value in values.items():
        columns |= {name: value} if value.ndim == 1 else {name + axis: value[:, k] for k, axis in enumerate(AXES)}
    head = ["ply", "format binary_little_endian 1.0", "comment metre and tesla", f"element vertex {len(points)}"]
    head += [f"property double {name}" for name in columns] + ["end_header", ""]
    stream.write("\n".join(head).encode())
    stream.write(np.column_stack(list(columns.values())).astype("<f8").tobytes())


def write_vtk_points(stream: BinaryIO, points: Points, values: Mapping[str, np.ndarray]) -> None:
    """Write points with numbers at each as legacy VTK (polydata of vertices)."""
    n = len(points)
    stream.write(_vtk_head("POLYDATA") + f"POINTS {n} double\n".encode() + _big_endian(points))
    cells = np.column_stack([np.ones(n), np.arange(n)]).astype(">i4")
    stream.write(f"\nVERTICES {n} {2 * n}\n".encode() + cells.tobytes())
    _write_vtk_values(stream, n, values)


def write_vtk_grid(
    stream: BinaryIO, axes: tuple[Scalars, Scalars, Scalars], spacing: float, values: Mapping[str, np.ndarray]
) -> None:
    """Write numbers on a regular grid (m), (nx, ny, nz) or (nx, ny, nz, 3), as legacy VTK (structured points)."""
    shape = [len(axis) for axis in axes]
    origin: Vector3 = np.array([axis[0] for axis in axes])
    head = (("DIMENSIONS", exact(shape)), ("ORIGIN", exact(origin)), ("SPACING", exact([spacing] * 3)))
    lines = "\n".join(f"{word} {' '.join(numbers)}" for word, numbers in head)
    stream.write(_vtk_head("STRUCTURED_POINTS") + lines.encode())
    # VTK counts x fastest.
    flat = {name: np.moveaxis(v, (0, 1, 2), (2, 1, 0)).reshape(-1, *v.shape[3:]) for name, v in values.items()}
    _write_vtk_values(stream, int(np.prod(shape)), flat)


def _vtk_head(kind: str) -> bytes:
    return f"# vtk DataFile Version 3.0\nmagmatch, metre and tesla\nBINARY\nDATASET {kind}\n".encode()


def _write_vtk_values(stream: BinaryIO, n: int, values: Mapping[str, np.ndarray]) -> None:
    stream.write(f"\nPOINT_DATA {n}\n".encode())
    for name, value in values.items():
        head = f"SCALARS {name} double 1\nLOOKUP_TABLE default\n" if value.ndim == 1 else f"VECTORS {name} double\n"
        stream.write(head.encode() + _big_endian(value) + b"\n")


def _big_endian(values: np.ndarray) -> bytes:
    return np.ascontiguousarray(values, dtype=">f8").tobytes()
