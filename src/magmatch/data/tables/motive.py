# SPDX-License-Identifier: BSD-3-Clause
"""The path of a rigid body in a CSV of Motive (OptiTrack), whose columns are named in several rows."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.tables.table import Table, Wanted, read_table
from magmatch.data.tables.text_rows import listed, split_row
from magmatch.data.tables.tum import TUM_COLUMNS
from magmatch.data.units import METRE_PER_UNIT, LengthUnit
from magmatch.errors import DataFormatError

logger = logging.getLogger(__name__)

_UNITS: dict[str, LengthUnit] = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}
_BODY = "rigid body"
_OURS = {("rotation", axis): "q" + axis for axis in "xyzw"} | {("position", axis): axis for axis in "xyz"}
# To z up, from y up, in which Motive writes unless told otherwise.
UPRIGHT = Rotation.from_euler("x", 90, degrees=True)


def is_of_motive(first: str) -> bool:
    """Whether a file that begins with this line is an export of Motive."""
    return first.startswith("Format Version,")


def read_motive(path: str | Path, lines: Sequence[str], length_unit: LengthUnit, *, recover: bool | None) -> Table:
    """Read the poses of the only rigid body as columns of TUM: times in s, z up, positions in the unit wanted.

    Frames in which the body was not seen have no numbers, and are left out.
    """
    cut = ((i, [cell.strip() for cell in split_row(line, ",")]) for i, line in enumerate(lines[:50]))
    rows = [(i, cells) for i, cells in cut if any(cells)]
    top, header = next(((i, cells) for i, cells in rows if cells[0].lower() == "frame" and len(cells) > 2), (0, []))
    above = [cells for i, cells in rows[1:] if i < top]
    if len(above) < 3:
        message = "is a CSV of Motive without the rows of types and names above 'Frame': export it with its header"
        raise DataFormatError(path, message)
    facts = rows[0][1]
    (types, names, *_), kinds = above, above[-1]
    stated = facts[facts.index("Length Units") + 1].lower() if "Length Units" in facts[:-1] else "none"
    if stated not in _UNITS:
        raise DataFormatError(path, f"expected Length Units of {', '.join(_UNITS)}; found {stated!r}", line=1)
    ours = [f"column {k + 1}" for k in range(len(header))]
    ours[1] = "t"
    bodies = []
    for k, (kind, body, part, axis) in enumerate(zip(types, names, kinds, header, strict=False)):
        if kind.lower() == _BODY:
            bodies += [body] if body not in bodies else []
            ours[k] = _OURS.get((part.lower(), axis.lower()), ours[k])
    _require_one(path, bodies, types, ours)
    used = [ours.index(name) for name in TUM_COLUMNS]
    seen = [""] * (top + 1)
    for line in lines[top + 1 :]:
        cells = split_row(line, ",")
        seen.append(line if all(k < len(cells) and cells[k].strip() for k in used[1:]) else "")
    n, n_seen = (sum(1 for line in some if line.strip()) for some in (lines[top + 1 :], seen))
    if not n_seen:
        raise DataFormatError(path, f"the rigid body {bodies[0]!r} is seen in none of {n} frames")
    if n_seen < n:
        logger.warning("%s: left out %d of %d frames in which %s is not seen", path, n - n_seen, n, bodies[0])
    table = read_table(path, Wanted(TUM_COLUMNS, ours, recover=recover), seen)
    logger.warning("%s: taken as y up, as Motive writes by default, and turned to z up", path)
    positions, turns = table.stack("x", "y", "z"), table.rotations()
    assert turns is not None  # its columns are required
    scale = METRE_PER_UNIT[_UNITS[stated]] / METRE_PER_UNIT[length_unit]
    upright = np.hstack([scale * UPRIGHT.apply(positions), (UPRIGHT * turns).as_quat()])
    return replace(table, columns={"t": table.columns["t"], **dict(zip(TUM_COLUMNS[1:], upright.T, strict=True))})


def _require_one(path: str | Path, bodies: Sequence[str], types: Sequence[str], ours: Sequence[str]) -> None:
    """Refuse an export that is not that of one rigid body with quaternions."""
    if not bodies:
        found = listed(sorted({kind for kind in types[2:] if kind}))
        message = f"expected the path of a rigid body, found {found}: make one of the markers in Motive"
        raise DataFormatError(path, f"{message}, and export it with rotations as quaternions")
    if len(bodies) > 1:
        message = f"expected one rigid body, found {listed(bodies)}: export"
        raise DataFormatError(path, f"{message} the one that carries the magnetometer alone")
    if missing := [name for name in TUM_COLUMNS if name not in ours]:
        message = f"expected rotation and position of {bodies[0]!r}; missing {', '.join(missing)}"
        raise DataFormatError(path, f"{message}: export both, with the rotation type Quaternion")
