# SPDX-License-Identifier: BSD-3-Clause
"""A log with odometry, whichever it is: a phone's log without poses is dead reckoned."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.phones.phone_log import PhoneLog, Sensor
from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.formats.sniff import sniff
from magmatch.data.read import read_survey, survey_of_phone
from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.preparation.odometry.dead_reckon import dead_reckon, usable

log = logging.getLogger(__name__)

# What dead reckoning may use, and the field, whose rows are thus checked before.
READ: tuple[Sensor, ...] = ("acceleration", "linear_acceleration", "gravity", "rate", "field")


@dataclass(frozen=True, eq=False, slots=True)
class OpenedWalk:
    """A log whose tables are read, and whose poses may still have to be computed."""

    path: Path
    layout: SurveyFormat
    given: Survey | None  # None where it has to be dead reckoned
    phone: PhoneLog | None = None  # which then is

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

    def survey(self, say: Callable[[str], None] = log.info) -> Survey:
        """The log with poses; says how far it was walked, if that is worked out."""
        if self.given is not None:
            return self.given
        assert self.phone is not None
        walk = dead_reckon(self.phone)
        say(f"Dead reckoning of {self.path.name}: {len(walk.steps)} steps, {walk.length:.1f} m")
        return replace(survey_of_phone(self.phone, self.layout, walk.trajectory), is_dead_reckoned=True)


def open_walk(path: str | Path, layout: SurveyFormat | None = None, *, with_points: bool = True) -> OpenedWalk:
    """Read the tables of a log with odometry, or of a phone's log, whose ``survey()`` is dead reckoned.

    Parameters
    ----------
    path : path
        A log of any format, or a saved map, which stands for its samples.
    layout : SurveyFormat, optional
        How it is to be read; with poses of a file of their own (``trajectory``) no log is dead reckoned.
    with_points : bool
        The points that a phone's walker marked are read, and have to be valid.

    Raises
    ------
    DataFormatError, SurveyError
        Whatever can be told to be wrong without dead reckoning.
    """
    path, layout = Path(path), layout or SurveyFormat()
    kind = sniff(path)
    if kind == "map":
        return OpenedWalk(path, layout, FieldMap.load(path).survey)
    is_phone = kind == "phone" and not layout.columns
    if is_phone and layout.trajectory is None:
        read = read_phone_log(path, READ, recover=layout.recover, with_points=with_points)
        usable(read)
        has_field = "field" in read.streams
        if not has_field and not read_phone_log(path, ["raw_field"], recover=layout.recover).streams:
            read.require("field", "a survey")
        return OpenedWalk(path, layout, None, read)
    if is_phone and with_points:
        read_phone_log(path, ["field"], recover=layout.recover, with_points=True)  # says what is wrong with them
    return OpenedWalk(path, layout, read_survey(path, layout))
