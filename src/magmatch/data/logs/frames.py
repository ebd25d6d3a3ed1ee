# SPDX-License-Identifier: BSD-3-Clause
"""The tree of frames that tf messages make: static edges and moving ones."""

from collections import deque
from dataclasses import dataclass
from functools import reduce
from operator import mul
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.logs.messages import Entries, Frames
from magmatch.data.logs.streams import in_order
from magmatch.data.tables.times import seconds_of
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError
from magmatch.typing import Mask, Matrix, Scalars

# m, and parts of a quaternion: some publishers work out a mount of a few metres in single precision each time.
ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class FrameTree:
    """Edges by (parent, child), that never move or over time; each takes child to parent coordinates."""

    static: dict[Frames, RigidTransform]
    moving: dict[Frames, Trajectory]

    def static_transform(self, to: str, frm: str) -> RigidTransform | None:
        """``T_to_from`` along static edges; None where they do not connect the two."""
        path = path_between(list(self.static), to, frm)
        if path is None:
            return None
        steps = (self.static[edge] if is_forward else self.static[edge].inv() for edge, is_forward in path)
        return reduce(mul, steps, RigidTransform.identity())

    def frames(self) -> list[str]:
        """All names of frames, sorted."""
        return sorted({name for edge in (*self.static, *self.moving) for name in edge})

    def root_over(self, frame: str) -> str:
        """The last frame reached from a frame by going to parents."""
        parents = {child: parent for parent, child in (*self.static, *self.moving)}
        seen = {frame}
        while parents.get(frame, frame) not in seen:
            frame = parents[frame]
            seen.add(frame)
        return frame

    def trajectory(self, path: Path, to: str, frm: str) -> Trajectory:
        """``T_to_from`` at every time at which a moving edge between them was stamped and all are known."""
        edges = path_between([*self.static, *self.moving], to, frm)
        if edges is None:
            known = ", ".join(self.frames()[:12]) or "no frames"
            raise DataFormatError(path, f"tf does not connect {frm!r} to {to!r}; it knows {known}")
        parts = [self.moving[edge] for edge, _ in edges if edge in self.moving]
        if not parts:
            raise DataFormatError(path, f"tf never moves {frm!r} against {to!r}: no poses between them")
        times = np.unique(np.concatenate([part.times for part in parts]))
        for part in parts:
            times = times[part.covers(times)]
        if len(times) < 2:
            raise DataFormatError(path, f"the moving tf edges between {to!r} and {frm!r} do not overlap in time")
        positions, turns = np.zeros((len(times), 3)), Rotation.identity(len(times))
        for edge, is_forward in edges:
            p, R = self._at(edge, times)
            if not is_forward:
                R = R.inv()
                p = -R.apply(p)
            positions, turns = positions + turns.apply(p), turns * R  # T_to_a T_a_b
        return Trajectory(times, positions, turns)

    def _at(self, edge: Frames, times: Scalars) -> tuple[np.ndarray, Rotation]:
        if edge in self.moving:
            return self.moving[edge].interpolate(times)
        T = self.static[edge]
        turns = np.tile(T.rotation.as_quat(), (len(times), 1))
        return np.tile(T.translation, (len(times), 1)), Rotation.from_quat(turns)


def frame_tree(path: Path, moving: dict[Frames, Entries], static: dict[Frames, Entries]) -> FrameTree:
    """Build the tree from the messages of ``/tf`` and ``/tf_static``; the last static transform of an edge holds."""
    fixed, edges = fixed_edges(moving, static), {}
    for frames, part in moving.items():
        if frames in fixed:
            continue
        ordered = in_order(path, f"tf {frames[0]} -> {frames[1]}", part)
        if len(ordered.number) > 1:
            edges[frames] = trajectory_of(path, ordered)
        else:
            fixed[frames] = _transform(part)
    return FrameTree(fixed, edges)


def fixed_edges(moving: dict[Frames, Entries], static: dict[Frames, Entries]) -> dict[Frames, RigidTransform]:
    """Edges that never move: those of ``/tf_static``, and those of ``/tf`` whose messages all say the same."""
    constant = {f: part for f, part in moving.items() if is_constant(part.values)}
    return {frames: _transform(part) for frames, part in (constant | static).items()}


def is_constant(values: Matrix) -> bool:
    """Whether poses are all the same."""
    return bool((np.ptp(_aligned(values), axis=0) <= ROUNDING).all())


def extremes(part: Entries) -> Entries:
    """The few entries of an edge that tell whether it is constant, and the one that was logged last."""
    if len(part.number) < 2:
        return part
    aligned = _aligned(part.values)
    return part.at(np.unique([*aligned.argmin(axis=0), *aligned.argmax(axis=0), _last(part)]))


def _aligned(values: Matrix) -> Matrix:
    """Poses with quaternions on the side of the first: a quaternion and its negative are one rotation."""
    signs = np.sign(values[:, 3:] @ values[0, 3:])
    return np.column_stack([values[:, :3], signs[:, None] * values[:, 3:]])


def trajectory_of(path: Path, entries: Entries) -> Trajectory:
    """Poses of entries in order; identities where they are positions only."""
    values = entries.values
    if len(values) < 2:
        raise DataFormatError(path, f"expected at least two poses, found {len(values)}")
    turns = Rotation.from_quat(values[:, 3:] if values.shape[1] == 7 else np.tile([0.0, 0, 0, 1], (len(values), 1)))
    times, is_new = distinct_seconds(entries)
    return Trajectory(times[is_new], values[is_new, :3].copy(), turns[is_new])


def distinct_seconds(entries: Entries) -> tuple[Scalars, Mask]:
    """Times in s, and which differ from the one before: float64 seconds since 1970 are 240 ns apart."""
    times = seconds_of(entries.stamp_ns.tolist())
    return times, np.concatenate([[True], np.diff(times) > 0])


def _transform(part: Entries) -> RigidTransform:
    """The one logged last."""
    last = part.values[_last(part)]
    return RigidTransform.from_components(last[:3], Rotation.from_quat(last[3:]))


def _last(part: Entries) -> int:
    return int(np.argsort(part.log_ns, kind="stable")[-1])


def path_between(edges: list[Frames], to: str, frm: str) -> list[tuple[Frames, bool]] | None:
    """Edges from one frame to another, and whether each is passed from parent to child; the fewest possible.

    None where nothing connects them, or one has no name.
    """
    if not (to and frm):
        return None
    steps: dict[str, list[tuple[Frames, bool, str]]] = {}
    for parent, child in edges:
        steps.setdefault(parent, []).append(((parent, child), True, child))
        steps.setdefault(child, []).append(((parent, child), False, parent))
    reached: dict[str, list[tuple[Frames, bool]]] = {to: []}
    waiting = deque([to])
    while waiting and frm not in reached:
        frame = waiting.popleft()
        for edge, is_forward, following in steps.get(frame, []):
            if following not in reached:
                reached[following] = [*reached[frame], (edge, is_forward)]
                waiting.append(following)
    return reached.get(frm)
