# SPDX-License-Identifier: BSD-3-Clause
"""The folder that slam and merge write: atomically, and never in place of other files."""

import secrets
import shutil
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from magmatch.data.fingerprint import describe_input
from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError
from magmatch.field.sensor_biases import without_bias
from magmatch.registration.clock import Clock
from magmatch.registration.g2o import RotationTangent
from magmatch.slam.graph.trajectories import corrected_poses
from magmatch.slam.output.graph_files import write_covariances, write_graph
from magmatch.slam.output.kept_session import SESSION, write_session
from magmatch.slam.result import SlamResult
from magmatch.slam.session import Session

RESULT, GRAPH, REPORT = "result.json", "graph.g2o", "report.html"
COVARIANCES = "covariances.csv"
# Writes the report, given what it is of and where it goes.
WriteReport = Callable[[Session, SlamResult, Path], None]


def write_folder(
    session: Session,
    folder: str | Path,
    report: WriteReport | None = None,
    poses: Sequence[Trajectory | None] | None = None,
    g2o_rotation: RotationTangent = "quaternion",
) -> SlamResult:
    """Write trajectories, surveys, maps, graph and result.

    They are written next to the folder and moved there once complete, the result last, so that it implies the rest.

    Parameters
    ----------
    session : Session
    folder : path
        New, or an earlier result of the same logs, which is replaced.
    report : callable, optional
        Writes the report.
    poses : sequence of Trajectory or None, optional
        Each log's own poses, where they have other times than its samples.
    g2o_rotation : str
        Convention of the rotation information in ``graph.g2o``: "quaternion" (g2o) or "angle" (GTSAM, Ceres).

    Returns
    -------
    SlamResult
        As written.

    Raises
    ------
    DataFormatError
        The folder holds something else.
    """
    folder = Path(folder)
    require_folder(folder, session.given, may_be_more=True)
    if not folder.resolve().parent.is_dir():
        raise DataFormatError(folder, f"the folder {folder.resolve().parent} does not exist; create it first")
    beside = unfinished(folder) / f"files-{secrets.token_hex(4)}"
    beside.mkdir(parents=True)
    try:
        write_graph(session.graph, beside / GRAPH, g2o_rotation)
        result = _write(session, beside, report, poses or [None] * len(session.given))
        _move(beside, folder)
        shutil.rmtree(beside.parent, ignore_errors=True)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
        with suppress(OSError):  # what was found on the way stays, where it was kept
            beside.parent.rmdir()
    return result


def require_folder(
    folder: str | Path,
    surveys: Sequence[Survey] | None,
    files: Iterable[str | Path] = (),
    *,
    may_be_more: bool = False,
    to_add: str = "",
) -> None:
    """Refuse a folder that holds anything but an earlier result of the same surveys, or one of their files.

    ``files`` are those of the surveys and whatever else is read; ``may_be_more``: some surveys may be new;
    ``to_add``: what would add them, for the message. Surveys that are not known yet (None) are not compared.
    """
    folder = Path(folder)
    if not folder.exists():
        return
    if not folder.is_dir():
        raise DataFormatError(folder, "is a file, expected the name of a folder to write to")
    inside = next((f for f in files if Path(f).resolve().is_relative_to(folder.resolve())), None)
    if inside is not None:
        raise DataFormatError(folder, f"holds an input ({inside}), which a result could replace; name another folder")
    if not any(folder.iterdir()):
        return
    advice = "name a new folder, or delete this one"
    if not (folder / RESULT).is_file():
        raise DataFormatError(folder, f"is not empty, and holds no earlier result ({RESULT}); {advice}")
    earlier = {entry.get("sha256"): entry.get("name") for entry in SlamResult.load(folder / RESULT).inputs}
    if surveys is None:
        return
    given = {describe_input(s)["sha256"] for s in surveys}
    if earlier.keys() < given and not may_be_more:
        raise DataFormatError(folder, f"holds a result of fewer inputs; {to_add}{advice}")
    if gone := [name for sha, name in earlier.items() if sha not in given]:
        what = "was changed, or is read otherwise" if gone[0] in {s.name for s in surveys} else "is not given"
        raise DataFormatError(folder, f"holds a result of other inputs: {gone[0]} {what}; {advice}")


def unfinished(folder: str | Path) -> Path:
    """Folder for intermediate results, next to the final folder, until that is complete."""
    place = Path(folder).resolve()
    return place.with_name(f".{place.name[:50]}.unfinished")


def _write(
    session: Session, folder: Path, report: WriteReport | None, poses: Sequence[Trajectory | None]
) -> SlamResult:
    clock = Clock()
    with clock("maps"):
        for k in range(len(session.components)):
            session.map(k).save(folder / ("map.map" if k == 0 else f"map_{k + 1}.map"))
    trajectories = [without_bias(s, b) for s, (b, _) in zip(session.trajectories, session.map_biases, strict=True)]
    for name, survey, path, own in zip(session.names, trajectories, session.paths, poses, strict=True):
        survey.save(folder / f"{name}.csv")
        if (there := corrected_poses(path, session.graph, own)) is not None:
            there.save(folder / f"{name}.tum")
    write_covariances(session, folder / COVARIANCES)
    write_session(session, folder / SESSION)
    result = session.result()
    if report is not None:
        report(session, result, folder / REPORT)
    spent = clock.seconds()
    total = session.seconds.get("total", 0.0) + spent["total"]
    session.seconds = session.seconds | spent | {"total": total}
    result = replace(result, seconds=dict(session.seconds))
    result.save(folder / RESULT)
    return result


def _move(beside: Path, folder: Path) -> None:
    """Take the place of the folder: in one step where it is new, file by file where it holds an earlier result."""
    if not folder.exists() or not any(folder.iterdir()):
        beside.replace(folder.resolve())
        return
    earlier = SlamResult.load(folder / RESULT)
    stale = {SESSION, REPORT} | {f"{log.name}{ending}" for log in earlier.logs for ending in (".csv", ".tum")}
    stale |= {f"map_{log.component + 1}.map" for log in earlier.logs}
    new = {path.name for path in beside.iterdir()}
    for name in sorted(stale - new):
        (folder / name).unlink(missing_ok=True)
    for name in sorted(new - {RESULT}):
        (beside / name).replace(folder / name)
    (beside / RESULT).replace(folder / RESULT)
