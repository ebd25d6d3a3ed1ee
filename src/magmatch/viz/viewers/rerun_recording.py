# SPDX-License-Identifier: BSD-3-Clause
"""A recording for the Rerun viewer: surveys, cuts through maps, and the target moving into place."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.errors import import_extra
from magmatch.geometry import transform_points
from magmatch.slam.session import Session
from magmatch.viz.figures.plotting import UT_PER_TESLA, magnitude_ut
from magmatch.viz.figures.slices import Cut, cut_through
from magmatch.viz.viewers.exhibit import Exhibit, Part, box_of, cut_colors, exhibit, shaded

# Steps of the timeline 'registration', from as recorded to registered.
N_STEPS = 20
POINT_SHARE = 0.002
LINK = (87, 96, 106)


def require_rerun() -> ModuleType:
    """Rerun's library."""
    return import_extra("rerun", "a Rerun recording", "rerun")


def write_rerun(path: str | Path, shown: Exhibit) -> None:
    """Write an exhibit for the Rerun viewer (.rrd), whole or not at all."""
    with _recording(path, shown) as (rr, recording):
        _log_registration(rr, recording, shown)


def write_session_rerun(path: str | Path, session: Session) -> None:
    """Write the largest component of a session for the Rerun viewer: its map, its logs on their way, and closures."""
    logs, graph = session.components[0], session.graph
    with _recording(path, exhibit([session.map(0)])) as (rr, recording):
        for k in logs:
            before = transform_points(session.logs[k].positions, session.T_map_log(k))
            moved = session.trajectories[k].positions - before
            for step in range(N_STEPS + 1):
                recording.set_time("correction", sequence=step)
                strip = (before + step / N_STEPS * moved).astype(np.float32)
                recording.log(_path(rr, "logs", session.names[k]), rr.LineStrips3D([strip]))
        for name, is_kept in (("closures", True), ("rejected", False)):
            tied = [c for c in graph.closures if c.is_kept == is_kept and int(graph.log[c.second]) in logs]
            if tied:
                strips = graph.p[[[c.first, c.second] for c in tied]].astype(np.float32)
                recording.log(name, rr.LineStrips3D(strips, colors=LINK), static=True)


@contextmanager
def _recording(path: str | Path, shown: Exhibit) -> Iterator[tuple[ModuleType, Any]]:
    """A recording of an exhibit to which more can be added, and which is then written."""
    rr = require_rerun()
    recording = rr.RecordingStream("magmatch")
    memory = recording.memory_recording()
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("words", rr.TextDocument("\n\n".join(shown.words)), static=True)
    for part in shown.parts:
        _log_part(rr, recording, shown, part)
    yield rr, recording
    content = memory.drain_as_bytes()
    with atomic_write(path) as stream:
        stream.write(content)


def _log_part(rr: ModuleType, recording: Any, shown: Exhibit, part: Part) -> None:
    """Samples, and the map on a cut."""
    low, high = box_of(shown)
    size = float(np.linalg.norm(high - low))
    magnitude = magnitude_ut(part.survey.field[part.rows])
    samples = rr.Points3D(
        part.survey.positions[part.rows].astype(np.float32),
        colors=shaded(magnitude, shown.limits).astype(np.uint8),
        radii=POINT_SHARE * size,
    )
    recording.log(_path(rr, part.name, "samples"), samples, static=True)
    # For the table of the viewer, and for programs that read the recording.
    bx, by, bz = UT_PER_TESLA * part.survey.field[part.rows].T
    values = rr.AnyValues(bx_ut=bx, by_ut=by, bz_ut=bz)
    recording.log(_path(rr, part.name, "samples"), values, static=True)
    if part.field_map is None:
        return
    cut = cut_through(part.survey.positions)
    colors, is_known = cut_colors(part.field_map, cut, "field magnitude", shown.limits)
    faces = _faces(cut, is_known)
    if len(faces):
        mesh = rr.Mesh3D(
            vertex_positions=cut.points.astype(np.float32),
            triangle_indices=faces,
            vertex_colors=colors.astype(np.uint8),
        )
        recording.log(_path(rr, part.name, "cut"), mesh, static=True)


def _log_registration(rr: ModuleType, recording: Any, shown: Exhibit) -> None:
    """The target's frame on its way, and the links that shrink with it."""
    if shown.T_base_target is None:
        return
    for step in range(N_STEPS + 1):
        recording.set_time("registration", sequence=step)
        T = shown.pose_of_target(step / N_STEPS)
        pose = rr.Transform3D(translation=T.translation, quaternion=rr.Quaternion(xyzw=T.rotation.as_quat()))
        recording.log("target", pose)
        links = shown.links(step / N_STEPS)
        if len(links):
            recording.log("links", rr.LineStrips3D(links, colors=LINK))


def _faces(cut: Cut, is_known: np.ndarray) -> np.ndarray:
    """Two triangles for every cell whose four corners are known."""
    rows, columns = len(cut.second), len(cut.first)
    number, known = np.arange(rows * columns).reshape(rows, columns), is_known.reshape(rows, columns)
    a, b, c, d = (number[i : rows - 1 + i, j : columns - 1 + j] for i, j in ((0, 0), (0, 1), (1, 1), (1, 0)))
    whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, 1:] & known[1:, :-1]
    a, b, c, d = (corner[whole] for corner in (a, b, c, d))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.uint32)


def _path(rr: ModuleType, *names: str) -> str:
    """Names may hold anything; paths escape what they must."""
    return str(rr.new_entity_path(list(names)))
