# SPDX-License-Identifier: BSD-3-Clause
"""What slam and merge know of their logs."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path as FilePath

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch._version import __version__
from magmatch.data.fingerprint import describe_input
from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.settings import Settings
from magmatch.slam.pose_graph import PoseGraph
from magmatch.slam.result import LogResult, Odometry, SlamResult, SlamStatus
from magmatch.slam.statement import explain, state_closure, state_odometry
from magmatch.slam.trajectories import corrected
from magmatch.slam.windows import Path
from magmatch.typing import Vector3


@dataclass(eq=False)
class Session:
    """Logs, the graph that ties them, and what follows from it.

    Attributes
    ----------
    given : list of Survey
        As they came.
    paths : list of Path
        Each without its sensor's bias, cut into windows.
    graph : PoseGraph
    config : Settings
        What was asked for: of slam or of merge.
    biases : tuple of (bias, sd)
        Of each log's magnetometer, in its own axes, T; empty for rigid surveys.
    seconds : dict
        Per stage and total.
    seed : int
    is_rigid : bool
        Whether each log is one node: merged, not corrected.
    """

    given: list[Survey]
    paths: list[Path]
    graph: PoseGraph
    config: Settings
    biases: tuple[tuple[Vector3, Vector3], ...]
    seconds: dict[str, float]
    seed: int = 0
    is_rigid: bool = False
    _maps: dict[int, FieldMap] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def names(self) -> list[str]:
        """Stems of the logs' names, made unique."""
        names: list[str] = []
        for survey in self.given:
            stem = FilePath(survey.name).stem or "log"
            others = (f"{stem}_{k}" for k in range(2, len(self.given) + 2))
            names.append(next(name for name in (stem, *others) if name.lower() not in map(str.lower, names)))
        return names

    @cached_property
    def trajectories(self) -> list[Survey]:
        """Each log with corrected positions, orientations and field, in the frame of its component."""
        frames = self.component_of
        return [
            replace(corrected(path, self.graph), frame="map" if not k else f"map_{k + 1}")
            for path, k in zip(self.paths, frames, strict=True)
        ]

    @cached_property
    def components(self) -> list[list[int]]:
        """Logs that share a frame, the component with the longest path first."""
        root = self.graph.component()[[path.first_node for path in self.paths]]
        groups = [np.flatnonzero(root == r).tolist() for r in np.unique(root)]
        return sorted(groups, key=lambda logs: -sum(self.paths[k].walked[-1] for k in logs))

    @property
    def component_of(self) -> list[int]:
        """Component of each log."""
        return [next(k for k, c in enumerate(self.components) if log in c) for log in range(len(self.paths))]

    def map(self, component: int = 0, config: FieldConfig | None = None) -> FieldMap:
        """One map of all logs of a component; with the default settings it is made once."""
        if config is None and component in self._maps:
            return self._maps[component]
        made = build_map([self.trajectories[k] for k in self.components[component]], config)
        if config is None:
            self._maps[component] = made
        return made

    def result(self) -> SlamResult:
        """What was found, as a document."""
        names, closures = self.names, self.graph.closures
        logs = tuple(self._state_log(k) for k in range(len(self.paths)))
        ties = [c for c in closures if c.is_kept]
        if not ties:
            status = SlamStatus.UNCHANGED
        else:
            status = SlamStatus.CONNECTED if len(self.components) == 1 else SlamStatus.PARTLY_CONNECTED
        groups = [[names[k] for k in group] for group in self.components]
        return SlamResult(
            status,
            explain(status, groups, len(ties), len(closures) - len(ties)),
            logs,
            tuple(state_closure(c, self.graph, self.paths, names, is_rigid=self.is_rigid) for c in closures),
            Odometry() if self.is_rigid else state_odometry(self.graph, self.biases, names),
            dict(self.seconds),
            self.config.model_dump(mode="json"),
            __version__,
            self.seed,
            tuple(describe_input(s) for s in self.given),
        )

    def _state_log(self, log: int) -> LogResult:
        path, after = self.paths[log], self.trajectories[log]
        component = self.component_of[log]
        T = self.T_map_log(log)
        moved = after.positions - T.apply(path.survey.positions)
        nodes = set(path.nodes.tolist())
        is_tied = len(self.paths) == 1 or len(self.components[component]) > 1
        return LogResult(
            self.names[log],
            component,
            T if is_tied else None,
            float(path.walked[-1]),
            sum(c.is_kept and bool({c.first, c.second} & nodes) for c in self.graph.closures),
            float(np.sqrt((moved**2).sum(axis=1).mean())),
            self.standard_deviations(path.nodes[-1:])[0],
        )

    def T_map_log(self, log: int) -> RigidTransform:
        """Corrected first pose of a log times the inverse of its odometry's."""
        path = self.paths[log]
        return self.graph.pose(path.first_node) * RigidTransform.from_translation(-path.windows[0].center)

    def standard_deviations(self, nodes: np.ndarray) -> list[tuple[float, float]]:
        """Of nodes against the first node of their component: m and rad."""
        component = self.graph.component()
        found = []
        for node in nodes:
            start = int(np.argmax(component == component[node]))
            C = self.graph.relative_covariances(np.array([start]), int(node))[0]
            place, turn = (float(np.sqrt(max(np.trace(block), 0.0))) for block in (C[3:, 3:], C[:3, :3]))
            found.append((place, turn))
        return found
