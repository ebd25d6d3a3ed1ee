# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch odometry``: dead reckoning of a walk from a phone's accelerometer and gyroscope."""

from pathlib import Path

from typer import Argument, Option

from magmatch.cli.command import command
from magmatch.cli.narration import say
from magmatch.cli.outputs import check_outputs
from magmatch.errors import DataFormatError

EXAMPLES = (
    "magmatch odometry walk.zip --out walk.tum",
    "magmatch prepare walk.zip --trajectory walk.tum --out walk.csv",
)
APPS = "phyphox, AndroSensor, Sensor Logger, GetSensorData, XYZ10, Android"


@command("odometry", EXAMPLES)
def odometry(
    log: Path = Argument(..., help=f"Phone's log: {APPS}.", metavar="LOG"),
    out: Path = Option(..., help="Write the poses here (TUM), on the log's clock.", metavar="TRAJECTORY"),
    step_scale: float = Option(
        1.0, min=0.3, max=3, help="Ratio of your step length to the average: true length of a path over ours."
    ),
    recover: bool = Option(False, "--recover", help="Skip rows without valid numbers, instead of refusing the log."),
) -> None:
    """Compute poses by dead reckoning for a LOG without any.

    Attitude comes from gyroscope and accelerometer; each step moves the position along the phone's heading, from the
    origin, at z = 0. Length is wrong by about 8 %, and heading drifts with the gyroscope.
    """
    from magmatch.data.formats.phones.read import read_phone_log
    from magmatch.data.formats.sniff import sniff
    from magmatch.preparation.odometry.dead_reckon import DeadReckoningConfig, dead_reckon

    check_outputs((out,), inputs=(log,))
    if (kind := sniff(log)) != "phone":
        words = f"is a {kind} file, expected a phone's log ({APPS})"
        raise DataFormatError(log, words)
    config = DeadReckoningConfig(step_scale=step_scale)
    walk = dead_reckon(
        read_phone_log(log, ("acceleration", "linear_acceleration", "gravity", "rate"), recover=recover), config
    )
    walk.trajectory.save(out)
    span = walk.trajectory.times[-1] - walk.trajectory.times[0]
    say(f"{len(walk.steps)} steps in {span:.0f} s, {walk.length:.1f} m (sd {walk.length_sd:.1f})\nWrote {out}")
