# SPDX-License-Identifier: BSD-3-Clause
"""A recording for the Rerun viewer: surveys, cuts through maps, and the target moving into place."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Slerp

from magmatch.atomic import write_whole
from magmatch.data.survey import Survey
from magmatch.errors import import_extra
from magmatch.field.map import FieldMap
from magmatch.geometry import rotation_matrix, transform_points
from magmatch.number_text import told
from magmatch.registration.maps import survey_of
from magmatch.registration.result import RegistrationResult
from magmatch.slam.session import Session
from magmatch.typing import Indices, Scalars, Vector3
from magmatch.viz.figures import draw
from magmatch.viz.figures.registration_figures import shown_pose
from magmatch.viz.figures.slices import Cut, cut_through, field_on, limits_of, map_in
from magmatch.viz.verdict import headline

# Steps of the timeline 'registration', from as recorded to registered.
N_STEPS = 20
# Radius of a sample on the screen.
POINT_SIZE = 1.5
LINK = (87, 96, 106)
# Most samples drawn of one survey: what the viewer turns smoothly without a graphics card.
MAX_SHOWN = 100_000
MAX_LINKS = 200
# Navy through grey to yellow: lightness rises all along, and nearly everyone tells blue from yellow.
SHADES = np.array([[0, 34, 78], [60, 77, 110], [124, 123, 120], [187, 175, 110], [254, 232, 56]], dtype=np.float64)


@dataclass(frozen=True, eq=False, slots=True)
class Part:
    """A survey or a map, in its own frame."""

    name: str  # unique among the parts; what its node is called
    survey: Survey
    field_map: FieldMap | None
    # (3,), m: the point of its frame that is its origin in the recording: positions there are of single precision
    origin: Vector3

    @property
    def rows(self) -> Indices:
        """Samples that are drawn."""
        return draw.thinned(len(self.survey), MAX_SHOWN)

    @property
    def words(self) -> str:
        """Description of what is drawn."""
        n, n_drawn = len(self.survey), len(self.rows)
        drawn = "" if n == n_drawn else f", {n_drawn} drawn"
        with_map = "" if self.field_map is None else ", with its map"
        return f"{self.name}: {self.survey.name}, {n} samples{drawn}{with_map}."


@dataclass(frozen=True, eq=False, slots=True)
class RerunScene:
    """Everything that a recording shows."""

    parts: tuple[Part, ...]  # with a registration: base and target
    # Pose of the target in the base, between their origins; the best candidate if none was accepted
    T_base_target: RigidTransform | None
    result: RegistrationResult | None
    # (float, float), uT: range of the colour scale of field magnitudes, common to all parts
    limits: tuple[float, float]

    @property
    def words(self) -> list[str]:
        """Description of the picture."""
        low, high = self.limits
        return [
            *([] if self.result is None else [headline(self.result) + ".", self.result.reason + "."]),
            *(part.words for part in self.parts),
            *(
                f"{part.name}: coordinates are relative to {', '.join(map(told, part.origin))} m."
                for part in self.parts
                if part.origin.any()
            ),
            f"Shades of field magnitude go from {low:.3g} uT (dark) to {high:.3g} uT (light).",
        ]

    def pose_of_target(self, share: float) -> RigidTransform:
        """Place the target on the way from as it was recorded (0) to registered (1)."""
        if self.T_base_target is None:
            return RigidTransform.identity()
        ends = np.stack([np.eye(3), rotation_matrix(self.T_base_target)])
        turn = Slerp([0.0, 1.0], type(self.T_base_target.rotation).from_matrix(ends))(share)
        return RigidTransform.from_components(share * self.T_base_target.translation, turn)


def scene_of(drawn: Sequence[Survey | FieldMap], result: RegistrationResult | None = None) -> RerunScene:
    """Assemble what a recording shows; with a result, its base and its target."""
    surveys = [survey_of(item) for item in drawn]
    names = ["base", "target"] if result is not None else _unique([survey.name for survey in surveys])
    origins = draw.origins_of(*(survey.positions for survey in surveys))
    parts = tuple(map(Part, names, surveys, map(map_in, drawn), origins))
    T_base_target = None if result is None else shown_pose(result)
    if T_base_target is not None:
        T_base, T_target = map(RigidTransform.from_translation, origins)
        T_base_target = T_base.inv() * T_base_target * T_target
    return RerunScene(parts, T_base_target, result, limits_of(*surveys))


def require_rerun() -> ModuleType:
    """Rerun's library."""
    return import_extra("rerun", "a Rerun recording", "rerun")


def write_rerun(path: str | Path, shown: RerunScene) -> None:
    """Write a scene for the Rerun viewer (.rrd), whole or not at all."""
    with _recording(path, shown) as (rr, recording):
        _log_registration(rr, recording, shown)


def write_session_rerun(path: str | Path, session: Session) -> None:
    """Write the largest component of a session for the Rerun viewer: its map, its logs on their way, and closures."""
    logs, graph = session.components[0], session.graph
    shown = scene_of([session.map(0)])
    origin = shown.parts[0].origin
    with _recording(path, shown) as (rr, recording):
        for k in logs:
            before = transform_points(session.logs[k].positions, session.T_map_log(k))
            moved = session.trajectories[k].positions - before
            for step in range(N_STEPS + 1):
                recording.set_time("correction", sequence=step)
                strip = (before + step / N_STEPS * moved - origin).astype(np.float32)
                recording.log(_path(rr, "logs", session.names[k]), rr.LineStrips3D([strip]))
        for name, is_kept in (("closures", True), ("rejected", False)):
            tied = [c for c in graph.closures if c.is_kept == is_kept and int(graph.log[c.second]) in logs]
            if tied:
                strips = (graph.p[[[c.first, c.second] for c in tied]] - origin).astype(np.float32)
                recording.log(name, rr.LineStrips3D(strips, colors=LINK), static=True)


@contextmanager
def _recording(path: str | Path, shown: RerunScene) -> Iterator[tuple[ModuleType, Any]]:
    """A recording of a scene to which more can be added, and which is then written."""
    rr = require_rerun()
    recording = rr.RecordingStream("magmatch")
    memory = recording.memory_recording()
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("words", rr.TextDocument("\n\n".join(shown.words)), static=True)
    for part in shown.parts:
        _log_part(rr, recording, part, shown.limits)
    yield rr, recording
    write_whole(path, memory.drain_as_bytes())


def _log_part(rr: ModuleType, recording: Any, part: Part, limits: tuple[float, float]) -> None:
    """Samples, and the map on a cut."""
    p, field = part.survey.positions[part.rows], part.survey.field[part.rows]
    samples = rr.Points3D(
        (p - part.origin).astype(np.float32),
        colors=shaded(draw.magnitude_ut(field), limits),
        radii=rr.Radius.ui_points(POINT_SIZE),
    )
    recording.log(_path(rr, part.name, "samples"), samples, static=True)
    # For the table of the viewer, and for programs that read the recording.
    bx, by, bz = draw.UT_PER_TESLA * field.T
    recording.log(_path(rr, part.name, "samples"), rr.AnyValues(bx_ut=bx, by_ut=by, bz_ut=bz), static=True)
    if part.origin.any():
        recording.log(_path(rr, part.name), rr.AnyValues(origin_m=part.origin), static=True)
    if part.field_map is None:
        return
    cut = cut_through(part.survey.positions)
    field, is_known = field_on(cut, part.field_map)
    faces = _faces(cut, is_known)
    if len(faces):
        mesh = rr.Mesh3D(
            vertex_positions=(cut.points - part.origin).astype(np.float32),
            triangle_indices=faces,
            vertex_colors=shaded(draw.magnitude_ut(field), limits),
        )
        recording.log(_path(rr, part.name, "cut"), mesh, static=True)


def _log_registration(rr: ModuleType, recording: Any, shown: RerunScene) -> None:
    """The target's frame on its way, and the links that shrink with it."""
    if shown.T_base_target is None or shown.result is None:
        return
    links, (base, target) = shown.result.links, shown.parts
    rows = draw.thinned(len(links.base), MAX_LINKS)
    starts, ends = links.base[rows] - base.origin, links.target[rows] - target.origin
    for step in range(N_STEPS + 1):
        recording.set_time("registration", sequence=step)
        T = shown.pose_of_target(step / N_STEPS)
        pose = rr.Transform3D(translation=T.translation, quaternion=rr.Quaternion(xyzw=T.rotation.as_quat()))
        recording.log("target", pose)
        if len(rows):
            strips = np.stack([starts, T.apply(ends)], axis=1).astype(np.float32)
            recording.log("links", rr.LineStrips3D(strips, colors=LINK))


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


def shaded(values: Scalars, limits: tuple[float, float]) -> np.ndarray:
    """Colours of numbers: (n, 3), 0 to 255."""
    low, high = limits
    place = np.clip((values - low) / (high - low), 0, 1) * (len(SHADES) - 1)
    channels = [np.interp(place, np.arange(len(SHADES)), channel) for channel in SHADES.T]
    return np.stack(channels, axis=1).astype(np.uint8)


def _unique(names: list[str]) -> list[str]:
    """Names of nodes: without slashes, which would nest them, and numbered where they repeat."""
    clean = [name.replace("/", "_") or "survey" for name in names]
    return [name if clean.count(name) == 1 else f"{name} {k + 1}" for k, name in enumerate(clean)]
