# SPDX-License-Identifier: BSD-3-Clause
"""A log with odometry for `slam`, `localize` and `replay`; dead reckoning for a phone's log without poses."""

from pathlib import Path
from typing import TYPE_CHECKING

from magmatch.cli.command import Layouts
from magmatch.cli.inputs import read_samples
from magmatch.cli.narration import say

if TYPE_CHECKING:
    from magmatch.data.survey import Survey


def is_dead_reckoned(path: Path, layouts: Layouts) -> bool:
    """Whether `read_walk` has to compute a log's poses from a phone's accelerometer and gyroscope."""
    from magmatch.data.formats.sniff import sniff

    layout = layouts.of()
    return sniff(path) == "phone" and layout.trajectory is None and not layout.columns


def read_walk(path: Path, layouts: Layouts) -> "Survey":
    """Read a log; poses of a phone's log are computed by dead reckoning, as by `odometry`."""
    from magmatch.data.formats.phones.read import read_phone_log
    from magmatch.data.read import read_phone_on
    from magmatch.preparation.odometry.dead_reckon import dead_reckon

    layout = layouts.of()
    if not is_dead_reckoned(path, layouts):
        return read_samples(path, layouts)
    phone = read_phone_log(path, ("acceleration", "linear_acceleration", "gravity", "rate"), recover=layout.recover)
    walk = dead_reckon(phone)
    say(f"Dead reckoning: {len(walk.steps)} steps, {walk.length:.1f} m")
    return read_phone_on(path, layout, walk.trajectory)
