# SPDX-License-Identifier: BSD-3-Clause
"""A log with odometry for `slam`, `localize` and `replay`; dead reckoning for a phone's log without poses."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from magmatch.cli.command import Layouts
from magmatch.cli.inputs import read_samples
from magmatch.cli.narration import say

if TYPE_CHECKING:
    from magmatch.data.formats.format import SurveyFormat
    from magmatch.data.formats.phones.phone_log import PhoneLog, Sensor
    from magmatch.data.survey import Survey

# What dead reckoning may use, and the field, whose rows are thus checked before.
READ: "tuple[Sensor, ...]" = ("acceleration", "linear_acceleration", "gravity", "rate", "field")


@dataclass(frozen=True, eq=False, slots=True)
class OpenedWalk:
    """A log whose tables are read, and whose poses may still have to be computed."""

    path: Path
    layout: "SurveyFormat"
    given: "Survey | None"  # None where it has to be dead reckoned
    phone: "PhoneLog | None"  # with the points that its walker marked, if asked for

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last time of its samples, s: before dead reckoning, of what it is computed from."""
        if self.given is not None:
            times = self.given.times
            return None if times is None else (float(times[0]), float(times[-1]))
        streams = self.phone.streams.values() if self.phone else ()
        if not streams:
            return None
        return float(max(s.times[0] for s in streams)), float(min(s.times[-1] for s in streams))

    def survey(self) -> "Survey":
        """The log with poses."""
        if self.given is not None:
            return self.given
        from magmatch.data.read import read_phone_on
        from magmatch.preparation.odometry.dead_reckon import dead_reckon

        assert self.phone is not None
        walk = dead_reckon(self.phone)
        say(f"Dead reckoning of {self.path.name}: {len(walk.steps)} steps, {walk.length:.1f} m")
        return read_phone_on(self.path, self.layout, walk.trajectory)


def open_walk(path: Path, layouts: Layouts, *, with_points: bool = False) -> OpenedWalk:
    """Read the tables of a log, with the points that a phone's walker marked if they are asked for."""
    from magmatch.data.formats.phones.read import read_phone_log
    from magmatch.data.formats.sniff import sniff

    layout = layouts.of()
    is_phone = sniff(path) == "phone" and not layout.columns
    has_poses = not is_phone or layout.trajectory is not None
    given = read_samples(path, layouts) if has_poses else None
    needs_log = is_phone and (with_points or not has_poses)
    log = read_phone_log(path, READ, recover=layout.recover, with_points=with_points) if needs_log else None
    return OpenedWalk(path, layout, given, log)


def read_walk(path: Path, layouts: Layouts) -> "Survey":
    """Read a log; poses of a phone's log are computed by dead reckoning, as by `odometry`."""
    return open_walk(path, layouts).survey()
