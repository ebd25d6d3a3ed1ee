# SPDX-License-Identifier: BSD-3-Clause
"""Windows of a log: parts of its path over which odometry is nearly rigid, each a node of the graph."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.checks import jumps
from magmatch.data.survey import Survey
from magmatch.estimation.walk import BIN_LENGTH, Walk, bin_along_path, bin_means, walk_of
from magmatch.geometry import path_walked, rotation_matrix, skew
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.slam.config import SlamConfig
from magmatch.typing import Indices, Points, Scalars, Vector3

# Lengthscales, or field lengths, of a part of a log.
PART_LENGTH = 25.0


@dataclass(frozen=True, eq=False)
class Window:
    """A part of a log's path."""

    log: int  # which log, and which node of the graph
    node: int
    survey: Survey  # its samples, odometry's frame
    center: Vector3  # (3,), m: place of the middle sample, the node's origin; the node's axes are the odometry's
    length: float  # m: field length
    config: SlamConfig
    # (vector, float): mean of the field along the whole log (T), odometry's frame, and variance of a component about
    # it (T^2)
    log_field: tuple[Vector3, float]

    def __getstate__(self) -> dict[str, object]:
        # What follows from these is computed again where it is needed.
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def path_length(self) -> float:
        """Path that windows are cut to, m."""
        return self.config.window_length * self.length

    @property
    def T_log_node(self) -> RigidTransform:
        """Transform to odometry's frame, from the node's."""
        return RigidTransform.from_translation(self.center)

    @cached_property
    def walk(self) -> Walk:
        """Samples of the window in bins along the path."""
        return walk_of(self.survey, self.length)

    @property
    def around(self) -> tuple[Vector3, float]:
        """Mean and variance of the log's field, walk's axes."""
        mean, variance = self.log_field
        return mean @ rotation_matrix(self.walk.T_survey_walk), variance

    @cached_property
    def T_middle_node(self) -> RigidTransform:
        """Transform to the middle of the walk, in the walk's axes, from the node."""
        walk = self.walk
        T_log_middle = walk.T_survey_walk * RigidTransform.from_translation(walk.positions.mean(axis=0))
        return T_log_middle.inv() * self.T_log_node

    @cached_property
    def bending(self) -> np.ndarray:
        """Effect of odometry's errors on it and on the path beside it, which drifts too: see `bend`; walk's axes."""
        T, c = self.walk.T_survey_walk, self.config
        positions = T.apply(self.walk.positions)
        about = int(np.argmin(np.linalg.norm(positions - self.center, axis=1)))
        odometry, upright = c.odometry_of(self.survey.name), c.is_gravity_aligned
        loads, R = bend(positions, about, odometry, upright=upright, planar=c.is_planar), rotation_matrix(T).T
        return np.asarray(np.sqrt(2.0) * np.concatenate([R @ loads[:, :3], R @ loads[:, 3:]], axis=1))

    @property
    def bends_by(self) -> float:
        """Rms error of its points' odometry positions relative to its middle, m."""
        return float(np.sqrt((self.bending[:, 3:] ** 2).sum(axis=(1, 2)).mean()))

    @property
    def keeps_shape(self) -> bool:
        """Whether it bends less than the reach of the field's gradient; otherwise it would fit anywhere."""
        return self.bends_by <= self.length


@dataclass(frozen=True, eq=False, slots=True)
class Path:
    """A log divided into windows."""

    survey: Survey  # without its sensor's bias, odometry's frame
    walked: Scalars  # (n,), m: path length up to each sample
    number: Indices  # (n,): window that each sample lies in
    windows: tuple[Window, ...]
    middles: Indices  # (k,): sample at which each window's node lies
    first_node: int  # node of the first window; the others follow
    jumps: Indices  # samples after which odometry jumps

    @property
    def nodes(self) -> Indices:
        """Nodes of its windows."""
        return self.first_node + np.arange(len(self.windows))

    @property
    def centers(self) -> Points:
        """Origins of the nodes, odometry's frame."""
        return np.stack([w.center for w in self.windows])

    def only(self, some: slice) -> "Path":
        """Select some windows of the log."""
        windows = self.windows[some]
        return replace(self, windows=windows, first_node=windows[0].node)


def cut(surveys: Sequence[Survey], length: float, config: SlamConfig, log: int = 0, first: int = 0) -> list[Path]:
    """Divide logs into windows of equal path length; ``length`` (m) is that over which the field changes.

    ``log`` and ``first`` are the number of the first log and of its first node.
    """
    paths: list[Path] = []
    for survey in surveys:
        walked = walked_along(survey, BIN_LENGTH * length)
        n = max(int(walked[-1] / (config.window_length * length)), 1)
        number = np.minimum((walked / max(walked[-1], 1e-9) * n).astype(np.int64), n - 1)
        # Where odometry jumps, whole windows hold no sample: they are none.
        number = np.unique(number, return_inverse=True)[1]
        n = int(number[-1]) + 1
        ends = np.searchsorted(number, np.arange(n + 1))
        half = [(walked[a] + walked[b - 1]) / 2 for a, b in pairwise(ends)]
        middles = np.clip(np.searchsorted(walked, half), ends[:-1], ends[1:] - 1)
        whole = mean_field(survey)
        windows = tuple(
            Window(log, first + k, survey.subset(number == k), survey.positions[middle], length, config, whole)
            for k, middle in enumerate(middles)
        )
        paths.append(Path(survey, walked, number, windows, middles, first, jumps(survey)))
        log, first = log + 1, first + n
    return paths


def mean_field(survey: Survey) -> tuple[Vector3, float]:
    """Mean of a log's field (T), and variance of a component about it (T^2)."""
    return survey.field.mean(axis=0), float(survey.field.var(axis=0).mean())


def walked_along(survey: Survey, side: float) -> Scalars:
    """Path walked up to each sample; jitter within a bin of some side adds nothing."""
    rows = bin_along_path(np.ascontiguousarray(survey.positions), side)
    counts = np.bincount(rows)
    means = bin_means(survey.positions, rows)
    middles = np.cumsum(counts) - (counts + 1) / 2
    return np.maximum.accumulate(np.interp(np.arange(len(survey)), middles, path_walked(means)))


def bend(positions: Points, about: int, odometry: OdometryConfig, *, upright: bool, planar: bool) -> np.ndarray:
    """Give the effect of m errors of unit variance on each point of a path: (n, 6, m), turn (rad), then shift (m).

    Between neighbouring points heading and position take a random step; errors of scale and turn rate are constant
    along the whole path. The point ``about`` stays; ``upright``: only the heading drifts; ``planar``: the height does
    not.
    """
    n = len(positions)
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    middles = (positions[1:] + positions[:-1]) / 2
    i, u = np.arange(n)[:, None], np.arange(n - 1)[None, :]
    # Which steps lie between the point that stays and another: those before it act the other way round.
    between = ((u >= about) & (u < i)).astype(float) - ((u < about) & (u >= i)).astype(float)
    axes = np.eye(3)
    turning, moving = (axes[2:] if upright else axes), (axes[:2] if planar else axes)
    arms = skew((positions[:, None] - middles[None]).reshape(-1, 3)).reshape(n, n - 1, 3, 3)
    columns = []
    for e in turning:
        # A turn by e at a step carries all that follows around it.
        carried = -arms @ e
        loads = np.concatenate([np.broadcast_to(e, carried.shape), carried], axis=2) * between[:, :, None]
        columns.append(np.moveaxis(loads * (odometry.rotation_sd * np.sqrt(steps))[None, :, None], 1, 2))
    for e in moving:
        loads = np.concatenate([np.zeros(3), e])[None, None] * between[:, :, None]
        columns.append(np.moveaxis(loads * (odometry.translation_sd * np.sqrt(steps))[None, :, None], 1, 2))
    columns.append(lasting_errors(positions, about, upright=upright) * [odometry.scale_sd, odometry.turn_rate_sd])
    return np.concatenate(columns, axis=2)


def lasting_errors(positions: Points, about: int, *, upright: bool) -> np.ndarray:
    """Give the effect of unit errors of scale (a share) and turn rate (rad/m, about z) on each point: (n, 6, 2)."""
    n = len(positions)
    found = np.zeros((n, 6, 2))
    found[:, 3:, 0] = positions - positions[about]
    if upright:
        walked = path_walked(positions)
        middles = (positions[1:] + positions[:-1]) / 2
        # The integral of e_z x (p - p_u) over the path between.
        moment = np.concatenate([np.zeros((1, 3)), np.cumsum(middles * np.diff(walked)[:, None], axis=0)])
        arm = positions * (walked - walked[about])[:, None] - (moment - moment[about])
        found[:, 2, 1] = walked - walked[about]
        found[:, 3:, 1] = np.cross([0.0, 0.0, 1.0], arm)
    return found
