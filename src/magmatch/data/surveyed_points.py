# SPDX-License-Identifier: BSD-3-Clause
"""`SurveyedPoints`: points of a plan or map that a walker marked when passing them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magmatch.data.geodesy import what_is_wrong
from magmatch.data.units import DAMAGED
from magmatch.errors import DataFormatError
from magmatch.number_text import told
from magmatch.typing import Indices, Matrix, Scalars

# m; the frame of a plan, or a map's projection: no place on Earth is further from its equator and meridian.
FARTHEST = 1e8
# A plan is mirrored if its mirror image fits a path by this much better. Of right plans of so many points, one in 300
# is taken for mirrored where odometry drifts three times as much as is usual.
MIRRORED, ENOUGH_FOR_A_PLAN = 3.0, 4


@dataclass(frozen=True, eq=False, slots=True)
class SurveyedPoints:
    """Points of a plan that the walker marked when passing them.

    Attributes
    ----------
    times : (n,) array, s
        On the log's clock.
    places : (n, 2) array
        x, y (m) in the plan's frame, or latitude, longitude (deg).
    in_degrees : bool
    floors : tuple of str
        Those that they lie on, as far as the log says.
    source : str
        The kind of row they came from.
    lines : (n,) array of int
        Where they stand in the file.
    """

    times: Scalars
    places: Matrix
    in_degrees: bool
    floors: tuple[str, ...]
    source: str
    lines: Indices

    @classmethod
    def checked(
        cls,
        path: Path,
        source: str,
        times: Scalars,
        places: Matrix,
        lines: Indices,
        floors: tuple[str, ...] = (),
        *,
        in_degrees: bool = False,
    ) -> "SurveyedPoints":
        """Points whose numbers are possible; DataFormatError names the first that is not."""
        for time, (x, y), line in zip(times, places, lines, strict=True):
            wrong = what_is_wrong(np.array([x]), np.array([y])) if in_degrees else ""
            if not in_degrees and max(abs(x), abs(y)) > FARTHEST:
                wrong = f"found x, y of {told(x)}, {told(y)}, expected metres within {FARTHEST:g} of the origin"
            if abs(time) > DAMAGED:
                wrong = f"found a time of {told(time)} s, expected one below {DAMAGED:g}"
            if wrong:
                raise DataFormatError(path, f"{source}: {wrong}", line=int(line))
        return cls(times, places, in_degrees, floors, source, lines)


def mirrored_misfits(places: Matrix, walked: Matrix) -> tuple[float, float] | None:
    """Distances of points of a plan, (n, 2), as given and mirrored, from where a path passed them, (n, 2); m.

    Each is rms, once the points are turned and shifted to fit; None unless the mirror image fits by far better.
    """
    if len(places) < ENOUGH_FOR_A_PLAN:
        return None
    apart = [points - points.mean(axis=0) for points in (places, walked)]
    H = apart[0].T @ apart[1]
    larger, smaller = np.linalg.svd(H, compute_uv=False)
    smaller *= np.sign(np.linalg.det(H))
    # The least squares of a turn (Kabsch): the singular values' sum, or difference where the turn must not reflect.
    total = sum(float((points**2).sum()) for points in apart)
    given, mirrored = (np.sqrt(max(total - 2 * (larger + s), 0.0) / len(places)) for s in (smaller, -smaller))
    return (float(given), float(mirrored)) if given > MIRRORED * mirrored else None
