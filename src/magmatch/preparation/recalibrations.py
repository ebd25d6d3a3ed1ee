# SPDX-License-Identifier: BSD-3-Clause
"""Jumps from a phone's own recalibration: the offset in the sensor's frame changes between two readings."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter

from magmatch.data.sensor_axes import HALF, find_repeats
from magmatch.preparation.calibrate_on_map import CalibrationEstimate
from magmatch.preparation.disturbances import find_saturation
from magmatch.preparation.preparation_report import StepReport
from magmatch.preparation.sensor_log import SensorLog
from magmatch.preparation.sensor_model import CHANNEL, PIECE
from magmatch.typing import VECTOR, Indices, Scalars, Vector3, Vectors

# Readings to either side that a jump is held against, how many times it exceeds the largest change among them, and
# the least of it. Phones waved about change by up to 12 uT from one reading to the next, and by as much beside it. In
# the 20 IPIN logs five are found, of 120, 58, 7, 6 and 5 uT: all but the fourth where the phone's own figure of
# accuracy changed, which it did nine times.
NEIGHBOURS, TIMES_LARGER, SMALLEST = 8, 3.0, 3e-6
# A phone recalibrates itself a few times at most; more is something else, and the largest are taken.
MOST = 8


@dataclass(frozen=True, eq=False, slots=True)
class Recalibrations:
    """The places where a log is to be cut."""

    rows: Indices  # (k,): first reading behind each jump, ascending
    steps: Vectors  # (k, 3), T: what each jump added to the readings, sensor frame
    refused: str = ""  # why jumps that were found are left as they are, in words

    def __len__(self) -> int:
        return len(self.rows)

    def withdrawn(self, why: str) -> "Recalibrations":
        """No cuts, for a reason in words."""
        return replace(NO_CUTS, refused=f"{len(self)} jumps found, none taken out: {why}")

    def piece_of(self, n: int) -> Indices:
        """Number of the piece that each of n readings belongs to."""
        return np.searchsorted(self.rows, np.arange(n), side="right")

    def channels(self, n: int) -> dict[str, Scalars]:
        """One channel for each piece but the longest, 1 within it: so that a calibration gives each a constant."""
        piece, longest = self.piece_of(n), self.longest(n)
        return {f"{PIECE}{k + 1}": (piece == k).astype(np.float64) for k in range(len(self) + 1) if k != longest}

    def longest(self, n: int) -> int:
        """Number of the longest piece of n readings."""
        return int(np.bincount(self.piece_of(n)).argmax())

    def joined(self, log: SensorLog, to: int | None = None) -> SensorLog:
        """The log with all pieces moved, by the jumps as measured, to a reading's, by default to the longest."""
        piece = self.piece_of(len(log))
        offsets = np.vstack([np.zeros(3), np.cumsum(self.steps, axis=0)])
        offsets -= offsets[self.longest(len(log)) if to is None else piece[to]]
        return replace(log, readings=log.readings - offsets[piece])


NO_CUTS = Recalibrations(np.zeros(0, dtype=np.int64), np.zeros(0, VECTOR))


def find_recalibrations(log: SensorLog) -> Recalibrations:
    """Jumps that stand out from all changes around them and last; none in a log without times.

    They must be the field's alone: where the carrier jumps or turns at once as well, the field may, too. A jump that
    a turn about the vertical explains is a turn that the poses show late, early or never.
    """
    field = log.orientations.apply(log.readings)
    # A reading that is held says nothing of how the field changes, whether it is turned with the carrier or not.
    new = np.flatnonzero(~(find_repeats(log.readings) | find_repeats(field)))
    if len(new) < len(log):
        found = find_recalibrations(log.subset(new))
        return replace(found, rows=new[found.rows])
    if log.times is None or len(log) < 4 * NEIGHBOURS:
        return NO_CUTS
    # In the survey's frame, so that turning is no change of the field; walking changes it evenly.
    changes = np.diff(field, axis=0)
    changes = changes - median_filter(changes, size=(2 * NEIGHBOURS + 1, 1), mode="nearest")
    change, step = np.linalg.norm(changes, axis=1), np.linalg.norm(np.diff(log.positions, axis=0), axis=1)
    turned = (log.orientations[:-1].inv() * log.orientations[1:]).magnitude() * np.linalg.norm(field[1:], axis=1)
    intervals = np.diff(log.times)
    # The end of the sensor's range holds readings still, and lets them go at once.
    is_free = ~find_saturation(log.readings)
    is_jump = is_free[1:] & is_free[:-1] & (change > SMALLEST)
    beside = _most_beside(change)
    is_jump &= (change > TIMES_LARGER * beside) & (step <= TIMES_LARGER * _most_beside(step))
    is_jump &= (turned <= TIMES_LARGER * _most_beside(turned)) | (TIMES_LARGER * turned < change)
    # Longer intervals are gaps, in which a field may change as it likes.
    is_jump &= intervals < TIMES_LARGER * np.median(intervals)
    candidates = [(row, _step(log, row)) for row in (np.flatnonzero(is_jump) + 1).tolist()]
    # A spike goes back.
    lasting = [(row, step) for row, step in candidates if np.linalg.norm(step) > HALF * change[row - 1]]
    most = np.maximum(SMALLEST, TIMES_LARGER * beside)
    lasting = [
        (r, step) for r, step in lasting if not _is_turn(field, r, log.orientations[r].apply(step), most[r - 1])
    ]
    largest = sorted(sorted(lasting, key=lambda found: -float(np.linalg.norm(found[1])))[:MOST], key=lambda f: f[0])
    rows = np.array([row for row, _ in largest], dtype=np.int64)
    return Recalibrations(rows, np.array([step for _, step in largest]).reshape(-1, 3))


def _is_turn(field: Vectors, row: int, step: Vector3, most: float) -> bool:
    """Whether a turn about the vertical leaves less than a third of a step (T, survey frame), and itself no jump."""
    before = field[max(row - NEIGHBOURS // 2, 0) : row].mean(axis=0)
    after = before + step
    left = float(np.hypot(np.hypot(*after[:2]) - np.hypot(*before[:2]), after[2] - before[2]))
    return bool(TIMES_LARGER * left < np.linalg.norm(step) and left < most)


def _most_beside(changes: Scalars) -> Scalars:
    """Find the largest of each change's neighbours on either side; endless at the ends."""
    before = maximum_filter1d(changes, NEIGHBOURS, origin=NEIGHBOURS // 2 - 1, mode="constant", cval=np.inf)
    after = maximum_filter1d(changes, NEIGHBOURS, origin=-(NEIGHBOURS // 2), mode="constant", cval=np.inf)
    beside = np.full(len(changes), np.inf)
    beside[1:-1] = np.maximum(before[:-2], after[2:])
    return beside


def _step(log: SensorLog, row: int) -> Vector3:
    """Measure what a jump before a row added, sensor frame: lines through both sides meet halfway."""
    assert log.times is not None  # or there are no jumps
    near = np.arange(row - NEIGHBOURS // 2, row + NEIGHBOURS // 2)
    # As the sensor would have read them in the attitude it had at the jump.
    turned = (log.orientations[row].inv() * log.orientations[near]).apply(log.readings[near])
    seconds = log.times[near] - (log.times[row - 1] + log.times[row]) / 2
    behind = (near >= row).astype(np.float64)
    # One slope for both sides: two would make the step noisier than a field that bends.
    design = np.column_stack([np.ones(len(near)), seconds, behind])
    return np.asarray(np.linalg.lstsq(design, turned, rcond=None)[0][2])


def recalibration_step(
    found: Recalibrations, log: SensorLog | None, calibration: CalibrationEstimate | None
) -> StepReport:
    """Report of the jumps, and of what the calibration found the pieces to differ by beside them."""
    if log is None or log.times is None:
        return StepReport("recalibration", "unknown", "needs orientations and times")
    if not len(found):
        words = found.refused or "no jump of the sensor's own calibration found"
        return StepReport("recalibration", "unchanged", words)
    jumps = [
        f"at {log.times[row]:.2f} s by {1e6 * np.linalg.norm(step):.3g} uT"
        for row, step in zip(found.rows, found.steps, strict=True)
    ]
    kept = {} if calibration is None or calibration.refused else calibration.chosen.estimate
    own = [name.removeprefix(CHANNEL + PIECE) for name in kept if name.startswith(CHANNEL + PIECE)]
    words = f"the sensor recalibrated itself {', '.join(jumps)}: cut there, each piece moved back by its jump"
    if own:
        words += f"; piece {', '.join(own)} with a hard iron of its own beside that"
    figures = {"times": log.times[found.rows].tolist(), "steps": found.steps.tolist(), "own_hard_iron": own}
    return StepReport("recalibration", "applied", words, len(found), 0, "jumps", figures)
