# SPDX-License-Identifier: BSD-3-Clause
"""Fixed points: known positions of a log at given times, in a surveyor's frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from magmatch.arguments import column_of, number_of, numbers_of
from magmatch.data.survey import Survey
from magmatch.data.tables.text import text_blocks
from magmatch.data.tables.text_rows import (
    advice_on_comments,
    cells_of,
    decimal_of_cells,
    delimiter_of,
    is_row,
    names_of,
    split_row,
    stated_delimiter,
)
from magmatch.data.tables.text_rows import numbers_of as numbers_in
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.number_text import told
from magmatch.slam.graph.factors import FixedPoints
from magmatch.slam.graph.trajectories import around
from magmatch.slam.windows import Path
from magmatch.typing import Vector3

NUMBERS = ("t", "x", "y", "z", "sd")
COLUMNS = ("log", *NUMBERS)


@dataclass(frozen=True, eq=False, slots=True)
class Anchor:
    """A fixed point that a log passed.

    Attributes
    ----------
    log : str
        Name of the log, with its ending or without.
    t : float, s
        On the log's own clock.
    position : (3,) array, m
        In the surveyor's frame.
    sd : float, m
        Standard deviation of each coordinate, above 0.
    source : str
        File and line, for messages.
    """

    log: str
    t: float
    position: Vector3
    sd: float
    source: str = "anchor"

    def __post_init__(self) -> None:
        column_of([self.t], f"{self.source}: t", "s", 1)
        number_of(self.sd, f"{self.source}: sd", "m", is_positive=True)
        position = numbers_of(self.position, f"{self.source}: position", "(3,)")
        if position.shape != (3,) or not np.isfinite(position).all():
            msg = f"{self.source}: position: expected three finite numbers (m), got {self.position!r:.60}"
            raise ValueError(msg)
        object.__setattr__(self, "position", position)

    @property
    def numbers(self) -> tuple[float, ...]:
        """As `NUMBERS` names them."""
        return (self.t, *self.position.tolist(), self.sd)


def read_anchors(path: str | FilePath) -> list[Anchor]:
    """Read fixed points from a table with the columns ``log,t,x,y,z,sd`` (s and m).

    Raises
    ------
    DataFormatError
        It is none; says line and column.
    """
    rows = [(b.start + i, line) for b in text_blocks(path, None) for i, line in enumerate(b.lines)]
    comments = [line.strip().lstrip("#").strip() for _, line in rows if line.strip() and not is_row(line)]
    rows = [(i, line) for i, line in rows if is_row(line)]
    mark = stated_delimiter(rows[0][1]) if rows else None
    rows = rows[1:] if mark else rows
    if len(rows) < 2:
        raise DataFormatError(path, f"expected a header row ({','.join(COLUMNS)}) and fixed points below, found none")
    (first, header), *rest = rows
    mark = mark if mark and mark in header else delimiter_of(path, header, first + 1)
    names = names_of(path, split_row(header, mark), first + 1, COLUMNS, comments)
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        message = f"expected columns {', '.join(COLUMNS)}; missing {', '.join(missing)}"
        raise DataFormatError(path, message + advice_on_comments(comments, len(names)), line=first + 1)
    at = [i for i, _ in rest]
    cells = cells_of(path, [line for _, line in rest], at, mark, names, is_last=True)
    wanted = {name: names.index(name) for name in NUMBERS}
    picked = ((i + 1, [row[k] for k in wanted.values()]) for i, row in zip(at, cells, strict=True))
    decimal = decimal_of_cells(path, picked, NUMBERS)
    numbers = numbers_in(path, at, cells, wanted, decimal)
    for i, sd in zip(at, numbers[:, -1], strict=True):
        if sd <= 0:
            raise DataFormatError(
                path, f"expected a standard deviation above 0 m, found {told(sd)}", line=i + 1, column="sd"
            )
    logs = [row[names.index("log")].strip() for row in cells]
    return [
        Anchor(log, float(n[0]), n[1:4], float(n[4]), f"{path}, line {i + 1}")
        for i, log, n in zip(at, logs, numbers, strict=True)
    ]


def of_logs(anchors: Sequence[Anchor], given: Sequence[Survey], names: Sequence[str]) -> list[tuple[Anchor, int]]:
    """Fixed points with the log that passed each; a ConfigurationError names the first that none did."""
    found = []
    for anchor in anchors:
        known = [{name, survey.name, FilePath(survey.name).name} for name, survey in zip(names, given, strict=True)]
        of = next((k for k, some in enumerate(known) if anchor.log in some), None)
        if of is None:
            msg = f"{anchor.source}: expected the name of a log ({', '.join(names)}), found {anchor.log!r}"
            raise ConfigurationError(msg)
        times = given[of].times
        if times is None:
            msg = f"{anchor.source}: log {anchor.log!r} has no times, which a fixed point needs"
            raise ConfigurationError(msg)
        if not times[0] <= anchor.t <= times[-1]:
            between = f"between {told(times[0])} and {told(times[-1])} s, when log {anchor.log!r} was walked"
            msg = f"{anchor.source}: expected a time {between}, found {told(anchor.t)}"
            raise ConfigurationError(msg)
        found.append((anchor, of))
    return found


def fixed_points(anchors: Sequence[tuple[Anchor, int]], paths: Sequence[Path]) -> FixedPoints:
    """Fixed points as factors of the two nodes around each."""
    one, other, share, x = [], [], [], []
    for anchor, log in anchors:
        path = paths[log]
        times = path.survey.times
        assert times is not None
        a, b, s = around(path, np.interp([anchor.t], times, path.walked))
        one.append(path.first_node + int(a[0]))
        other.append(path.first_node + int(b[0]))
        share.append(float(s[0]))
        x.append([np.interp(anchor.t, times, axis) for axis in path.survey.positions.T])
    return FixedPoints(
        np.array(one, dtype=np.int64),
        np.array(other, dtype=np.int64),
        np.array(share),
        np.array(x).reshape(-1, 3),
        np.array([a.position for a, _ in anchors]).reshape(-1, 3),
        np.array([a.sd for a, _ in anchors]),
    )
