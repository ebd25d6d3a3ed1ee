# SPDX-License-Identifier: BSD-3-Clause
"""Logs that are divided into windows, and the pose graph of these."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.checks import extent
from magmatch.data.sensor_axes import is_constant
from magmatch.data.survey import Survey
from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.pose_prior import UP
from magmatch.field.sensor_biases import without_bias
from magmatch.preparation.odometry.drift import FACTORS, lie_level
from magmatch.progress import tell
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor, fixed_points
from magmatch.slam.graph.learned_drift import with_factors
from magmatch.slam.graph.odometry import follow, odometry_graph
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.solve import forget_closures, solve
from magmatch.slam.graph.trajectories import moved
from magmatch.slam.search.loop_closure import earlier_passes
from magmatch.slam.search.submaps import SubmapMaker
from magmatch.slam.sensor_bias import in_one_calibration, sensor_bias
from magmatch.slam.shared_hyperparameters import N_PARTS, shared_hyperparameters
from magmatch.slam.windows import Path, Window, cut
from magmatch.typing import Indices, Points, Vector3

log = logging.getLogger(__name__)

# Of a magnetometer in its own axes, and sd, T.
Bias = tuple[Vector3, Vector3]
NO_BIAS: Bias = (np.zeros(3), np.zeros(3))


@dataclass(eq=False, slots=True)
class Places:
    """Windows of logs, and where the graph has them."""

    paths: list[Path]  # each without its sensor's bias
    graph: PoseGraph
    stated: SlamConfig
    maker: SubmapMaker | None = None  # None if the field is constant and tells no places apart
    biases: list[Bias] = field(default_factory=list)  # of each log's magnetometer
    # List of (Anchor, int): fixed points, and the log that passed each
    anchors: list[tuple[Anchor, int]] = field(default_factory=list)
    is_rigid: bool = False  # whether each log is one node: merged, not corrected

    def copied(self, anchors: Sequence[tuple[Anchor, int]] = ()) -> "Places":
        """Copy it, to continue with more fixed points without changing this one."""
        paths, biases, anchors = list(self.paths), list(self.biases), [*self.anchors, *anchors]
        return replace(self, paths=paths, graph=self.graph.copied(), biases=biases, anchors=anchors)

    def add(self, survey: Survey) -> Path:
        """Cut one more log into windows, in a frame of its own."""
        assert self.maker is not None
        if self.graph.config.is_planar and not lie_level([*(path.survey for path in self.paths), survey]):
            words = "%s: lies at another height than the logs before it, or leans: heights are estimated from now on"
            log.warning(words, survey.name)
            self.stated = self.stated.model_copy(update={"is_planar": False})
            self.take_drift(self.graph.config.model_copy(update={"is_planar": False}))
        survey = in_one_calibration(survey)
        config = self.graph.config
        bias = sensor_bias(survey, self.maker.hyperparameters, config)
        unbiased = without_bias(survey, bias[0])
        (path,) = cut([unbiased], self.maker.length, config, len(self.paths), len(self.graph.p))
        self.biases.append(bias)
        self.paths.append(path)
        self.solve()
        return path

    def solve(self) -> None:
        """Find the poses of all nodes, those of the last log's new windows too."""
        follow(self.paths[-1], self.graph)
        if here := [(anchor, log) for anchor, log in self.anchors if log < len(self.paths)]:
            self.graph.fixed = fixed_points(here, self.paths)  # others have yet to be added
        solve(self.graph)

    def take_drift(self, config: SlamConfig) -> None:
        """Take odometry to drift otherwise, and solve with that."""
        self.graph.config = config
        self.paths = [replace(p, windows=tuple(replace(w, config=config) for w in p.windows)) for p in self.paths]
        self.graph.edges = odometry_graph(self.paths, config).edges
        self.solve()

    def without_vertical(self, logs: Sequence[int], offset: float) -> "Places":
        """The same places, but what some logs measured without so much (T) along the vertical, a bias of theirs."""
        less, along = self.copied(), offset * UP
        for k in logs:
            path, (bias, sd) = self.paths[k], self.biases[k]
            survey = replace(path.survey, field=path.survey.field - along)
            (less.paths[k],) = cut([survey], path.windows[0].length, self.graph.config, k, path.first_node)
            R = survey.orientations
            less.biases[k] = bias + (along if R is None else R.inv().apply(along).mean(axis=0)), sd
        return less

    def drifting_more(self) -> "Places":
        """The same logs without closures, whose odometry drifts by a standard deviation more of what it may."""
        more = self.copied()
        forget_closures(more.graph)
        more.stated = with_factors(self.stated, FACTORS[[-1, -1]])
        more.take_drift(more.stated)
        return more

    def path(self, node: int) -> Path:
        """The log that a node lies on."""
        return self.paths[int(self.graph.log[node])]

    def window(self, node: int) -> Window:
        """The window of a node."""
        path = self.path(node)
        return path.windows[node - path.first_node]

    def body_at(self, node: int) -> tuple[RigidTransform, float | None, float]:
        """Body in the axes of a node, when it was there, and how far it had walked; of a rigid survey, its frame."""
        path = self.path(node)
        if self.is_rigid:
            return self.window(node).T_log_node.inv(), None, 0.0
        at, survey = int(path.middles[node - path.first_node]), path.survey
        R = Rotation.identity() if survey.orientations is None else survey.orientations[at]
        t = None if survey.times is None else float(survey.times[at])
        return RigidTransform.from_rotation(R), t, float(path.walked[at])

    def known_to(self, window: Window) -> Indices:
        """Earlier nodes that share a window's frame."""
        component = self.graph.component()
        return earlier_passes(window, np.flatnonzero(component == component[window.node]), self.graph)

    def others(self, path: Path) -> list[Path]:
        """Earlier logs that no closure connects to this one."""
        component = self.graph.component()
        earlier = [p for p in self.paths if p.first_node < path.first_node]
        return [p for p in earlier if component[p.first_node] != component[path.first_node]]

    def points_of(self, nodes: Indices) -> Points:
        """Samples of the windows of some nodes, where the graph has them: (n, 3), m."""
        found = []
        for path in self.paths:
            rows = np.isin(path.nodes, nodes)[path.number]
            found.append(moved(path, self.graph, path.walked[rows], path.survey.positions[rows]))
        return np.concatenate(found)


def settled(given: Sequence[Survey], config: SlamConfig) -> SlamConfig:
    """Complete the settings with what the logs show of themselves: whether they lie level."""
    is_level = lie_level(given)
    if config.is_planar and not is_level:
        z = np.concatenate([survey.positions[:, 2] for survey in given])
        words = "stated as planar, but heights go from %.2f to %.2f m, or bodies lean: unstated, both are estimated"
        log.warning(words, z.min(), z.max())
    if not config.is_gravity_aligned or config.is_planar or not is_level:
        return config
    log.info("all poses lie at one height: taken as planar")
    return config.model_copy(update={"is_planar": True})


def begin(
    given: Sequence[Survey], config: SlamConfig, anchors: Sequence[tuple[Anchor, int]] = (), n_parts: int = N_PARTS
) -> Places:
    """Cut logs into windows, where odometry has them; the field's length is learned from so many parts."""
    maker, biases = None, [NO_BIAS] * len(given)
    if all(is_constant(survey.field) for survey in given):  # it has no length
        paths = cut(given, max(float(extent(survey).max()) for survey in given), config)
    else:
        tell("learning how the field changes")
        given = [in_one_calibration(survey) for survey in given]
        h, length, measured = shared_hyperparameters(given, n_parts)
        biases = [sensor_bias(survey, h, config) for survey in given]
        unbiased = [without_bias(survey, bias) for survey, (bias, _) in zip(given, biases, strict=True)]
        paths = cut(unbiased, length, config)
        n_windows, walked = sum(len(p.windows) for p in paths), config.window_length * length
        log.info("field length %.2f m; %d windows of %.1f m", length, n_windows, walked)
        # A guess of the field that does not repeat from walk to walk, before any two were compared.
        noise = PathNoise.guess(length, 0.25 * h.signal_sd, 0.25 * h.noise_sd, 0.1 * h.signal_sd)
        maker = SubmapMaker(h, measured, noise, length)
    places = Places(paths, odometry_graph(paths, config), config, maker, biases, [*anchors])
    places.solve()
    return places
