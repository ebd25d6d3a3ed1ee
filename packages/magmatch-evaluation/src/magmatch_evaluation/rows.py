# SPDX-License-Identifier: BSD-3-Clause
"""Rows that outlive a crash: appended line by line, each batch on the disk before the next is counted."""

import csv
import json
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from io import StringIO
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from magmatch.atomic import write_whole
from magmatch.errors import DataFormatError

Key = tuple[str, str, int, str]


@dataclass(frozen=True, slots=True)
class Trial:
    """Which trial a row is of; the digest is the fingerprint of the settings and the code it was made with."""

    experiment: str
    method: str
    seed: int
    digest: str

    @property
    def key(self) -> Key:
        """What no two rows share."""
        return self.experiment, self.method, self.seed, self.digest


@dataclass(frozen=True, slots=True)
class Row(Trial):
    """What came of registering one pair."""

    FILE: ClassVar[str] = "rows"

    status: str  # of the result; status ``fault`` where the method broke down
    reason: str
    is_accepted: bool
    is_there: bool  # whether there was anything to be found
    distance: float  # m and rad: error of the best pose, accepted or not; inf where there is none
    angle: float  # m and rad
    nees: float  # per degree of freedom; NaN where no covariance is stated
    n_base: int  # samples
    n_target: int
    seconds: float  # s: of the processor, maps included
    peak_bytes: int


@dataclass(frozen=True, slots=True)
class MapRow(Trial):
    """How well one model of the field predicted what was held out."""

    FILE: ClassVar[str] = "mapping"

    reason: str  # why there is no figure; empty where there is
    field_rmse: float  # T: of 3-vectors
    gradient_rmse: float  # T/m: of the nine components together; NaN where truth or model have none
    coverage: float  # share of components within the stated 95 %; NaN where none is stated
    seconds: float  # s: of the processor


AnyRow = Row | MapRow
R = TypeVar("R", bound=Trial)


class RowFile(Generic[R]):
    """Rows of one kind in a file of JSON lines that only ever grows, created with the first row."""

    def __init__(self, path: Path, kind: type[R]) -> None:
        self.path = path
        self.kind: type[R] = kind

    def read(self) -> list[R]:
        """Read all whole rows as they were written, the first of equal keys only; a line cut off is left out."""
        if not self.path.exists():
            return []
        *lines, _ = self.path.read_bytes().split(b"\n")
        rows = [self._parsed(line, number) for number, line in enumerate(lines, start=1)]
        return list({row.key: row for row in reversed(rows)}.values())[::-1]

    def append(self, rows: Iterable[R]) -> None:
        """Write rows; once this returns they are on the disk."""
        text = "".join(json.dumps(_plain(row)) + "\n" for row in rows)
        with self.path.open("ab") as stream:
            stream.write(text.encode())
            stream.flush()
            os.fsync(stream.fileno())

    def mend(self) -> None:
        """Cut off what a crash left of a line, so that the next row does not continue it."""
        if self.path.exists():
            content = self.path.read_bytes()
            os.truncate(self.path, content.rfind(b"\n") + 1)

    def _parsed(self, line: bytes, number: int) -> R:
        missing = {"distance": math.inf, "angle": math.inf}
        try:
            content: dict[str, Any] = json.loads(line)
            filled: Any = {k: missing.get(k, math.nan) if v is None else v for k, v in content.items()}
            return self.kind(**filled)
        except (ValueError, TypeError, AttributeError):
            why = "is not a row of an evaluation; use another folder"
            raise DataFormatError(self.path, why, line=number) from None


def write_csv(path: Path, rows: Sequence[R], kind: type[R]) -> None:
    """Write rows as a table for other programs, in an order that does not depend on when they were made."""
    buffer = StringIO()
    writer = csv.DictWriter(buffer, [f.name for f in fields(kind)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in sorted(rows, key=lambda row: row.key))
    write_whole(path, buffer.getvalue().encode())


def _plain(row: Trial) -> dict[str, Any]:
    """JSON has no inf and no NaN: both become null, and a distance that is null is inf again."""
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(row).items()}
