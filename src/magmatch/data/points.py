# SPDX-License-Identifier: BSD-3-Clause
"""Points and grids for ParaView and its kin: PLY and legacy VTK, binary, double precision."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from magmatch.atomic import write_whole
from magmatch.number_text import exact
from magmatch.typing import Points, Scalars, Vector3

AXES = "xyz"


def write_ply(path: str | Path, points: Points, values: Mapping[str, np.ndarray]) -> None:
    """Write points (m) with numbers at each as PLY; a vector ``b`` becomes the properties ``bx, by, bz``."""
    columns = dict(zip(AXES, points.T, strict=True))
    for name, value in values.items():
        columns |= {name: value} if value.ndim == 1 else {name + axis: value[:, k] for k, axis in enumerate(AXES)}
    head = ["ply", "format binary_little_endian 1.0", "comment metre and tesla", f"element vertex {len(points)}"]
    head += [f"property double {name}" for name in columns] + ["end_header", ""]
    rows = np.column_stack(list(columns.values())).astype("<f8").tobytes()
    write_whole(path, "\n".join(head).encode() + rows)


def write_vtk_points(path: str | Path, points: Points, values: Mapping[str, np.ndarray]) -> None:
    """Write points with numbers at each as legacy VTK (polydata of vertices)."""
    n = len(points)
    cells = np.column_stack([np.ones(n), np.arange(n)]).astype(">i4").tobytes()
    vertices = f"\nVERTICES {n} {2 * n}\n".encode() + cells
    _write_vtk(path, "POLYDATA", f"POINTS {n} double\n".encode() + _big_endian(points) + vertices, n, values)


def write_vtk_grid(
    path: str | Path, axes: tuple[Scalars, Scalars, Scalars], spacing: float, values: Mapping[str, np.ndarray]
) -> None:
    """Write numbers on a regular grid (m), (nx, ny, nz) or (nx, ny, nz, 3), as legacy VTK (structured points)."""
    shape = [len(axis) for axis in axes]
    origin: Vector3 = np.array([axis[0] for axis in axes])
    head = (("DIMENSIONS", exact(shape)), ("ORIGIN", exact(origin)), ("SPACING", exact([spacing] * 3)))
    lines = "\n".join(f"{word} {' '.join(numbers)}" for word, numbers in head)
    # VTK counts x fastest.
    flat = {name: np.moveaxis(v, (0, 1, 2), (2, 1, 0)).reshape(-1, *v.shape[3:]) for name, v in values.items()}
    _write_vtk(path, "STRUCTURED_POINTS", lines.encode(), int(np.prod(shape)), flat)


def _write_vtk(path: str | Path, kind: str, geometry: bytes, n: int, values: Mapping[str, np.ndarray]) -> None:
    head = f"# vtk DataFile Version 3.0\nmagmatch, metre and tesla\nBINARY\nDATASET {kind}\n"
    parts = [head.encode(), geometry, f"\nPOINT_DATA {n}\n".encode()]
    for name, value in values.items():
        head = f"SCALARS {name} double 1\nLOOKUP_TABLE default\n" if value.ndim == 1 else f"VECTORS {name} double\n"
        parts += [head.encode(), _big_endian(value), b"\n"]
    write_whole(path, b"".join(parts))


def _big_endian(values: np.ndarray) -> bytes:
    return np.ascontiguousarray(values, dtype=">f8").tobytes()
