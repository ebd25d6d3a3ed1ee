# SPDX-License-Identifier: BSD-3-Clause
"""`slam` and `merge` end alike: they write the folder, print a summary, and give the exit code."""

from collections.abc import Sequence
from math import degrees, hypot, pi, sqrt
from pathlib import Path
from typing import TYPE_CHECKING

from magmatch.cli.narration import say
from magmatch.cli.outputs import answer
from magmatch.number_text import told

if TYPE_CHECKING:
    from magmatch.data.trajectory import Trajectory
    from magmatch.registration.g2o import RotationTangent
    from magmatch.slam.result import SlamResult
    from magmatch.slam.session import Session


def deliver(
    session: "Session",
    out: Path,
    again: str,
    poses: "Sequence[Trajectory | None]",
    g2o_rotation: "RotationTangent",
    *,
    json: bool,
    rerun: Path | None = None,
) -> int:
    """Write the folder, whose report says the command `again`; the exit code is whether all logs are in one frame."""
    from magmatch.data.geodesy import Origin
    from magmatch.errors import MissingExtraError
    from magmatch.slam.output.folder import REPORT, write_folder
    from magmatch.viz.pages.session_page import write_session_report

    if g2o_rotation != "quaternion":
        again += f" --g2o-rotation {g2o_rotation}"

    def write_report(session: "Session", result: "SlamResult", path: Path) -> None:
        try:
            write_session_report(path, session, result, again)
        except MissingExtraError as error:
            say(f"warning: no {REPORT}: {error}")

    result = write_folder(session, out, write_report, poses, g2o_rotation)
    if rerun is not None:
        from magmatch.viz.rerun_recording import write_session_rerun

        write_session_rerun(rerun, session)
    said = ["Taken as planar: all poses at one height"] if session.graph.config.is_planar else []
    if (origin := getattr(session.config, "origin", None)) is not None:
        said.append(f"x and y: metres east and north of {Origin(*origin)}")
    words = "\n".join([*said, tell(result), f"Wrote {out}"])
    return answer(result, words, is_good=result.is_connected, json=json)


def tell(result: "SlamResult") -> str:
    """Summarise a session in a line, and each log in another."""
    status = result.status.replace("_", " ").capitalize()
    lines = [f"{status}: {result.reason}"]
    width = max(len(log.name) for log in result.logs)
    for log in result.logs:
        place, turn = log.sd
        known = "not known: nothing holds its heading"
        if turn < pi:
            known = f"known to {place:.2g} m, {round(degrees(turn), 4):.2g} degrees"
        # Rigid surveys have no odometry and are moved as a whole.
        walked = f"{log.length:.1f} m, moved {log.moved:.2f} m, its end {known}" if result.odometry else known
        lines.append(f"  {log.name:{width}}  frame {log.component}, closures {log.n_closures}, {walked}")
    return "\n".join(lines + ([_passed(result)] if result.anchors else []))


def _passed(result: "SlamResult") -> str:
    """How far off the logs pass their fixed points, to which they are fitted, and what else shows it."""
    points, tested = result.anchors, result.tested_anchors()
    if not tested:
        return f"  Fixed points: {len(points)}, to which the path is fitted; too few to show how far off it is"
    off = [hypot(*p.off) for p in points]
    far = max(range(len(points)), key=off.__getitem__)
    each = "each" if len(tested) == len(points) else f"each of {len(tested)}"
    without = _rms([hypot(*p.off_without) for p in tested])
    return (
        f"  Fixed points: passed {_rms(off):.2f} m off (rms), {off[far]:.2f} m at most ({points[far].log} at "
        f"{told(points[far].t)} s); {without:.2f} m (rms) where {each} is left out"
    )


def _rms(values: Sequence[float]) -> float:
    return sqrt(sum(value * value for value in values) / len(values))
