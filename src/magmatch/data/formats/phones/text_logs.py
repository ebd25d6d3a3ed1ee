# SPDX-License-Identifier: BSD-3-Clause
"""Apps that write one text of rows, each row named after its sensor."""

from codecs import BOM_UTF8
from collections.abc import Callable
from dataclasses import dataclass

from magmatch.data.formats.phones import getsensordata, xyz10
from magmatch.data.formats.phones.phone_log import Sensor, Stream
from magmatch.data.surveyed_points import SurveyedPoints

HEAD = 1_000_000  # bytes that decide


@dataclass(frozen=True, slots=True)
class TextLog:
    """An app's text: how it is told, and read."""

    app: str
    begins_like: Callable[[bytes], bool]
    read: Callable[..., dict[Sensor, Stream]]
    points: Callable[..., SurveyedPoints | None]


TEXT_LOGS = (
    TextLog(
        getsensordata.APP,
        getsensordata.is_getsensordata,
        getsensordata.read_getsensordata,
        getsensordata.points_of_getsensordata,
    ),
    TextLog(xyz10.APP, xyz10.is_xyz10, xyz10.read_xyz10, xyz10.points_of_xyz10),
)


def text_log_of(head: bytes) -> TextLog | None:
    """Tell the app whose text a file begins like, if any."""
    text = head[:HEAD].removeprefix(BOM_UTF8)
    return next((log for log in TEXT_LOGS if log.begins_like(text)), None)
