# SPDX-License-Identifier: BSD-3-Clause
"""What slam and merge know of their logs."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.slam.pose_graph import PoseGraph
from magmatch.slam.trajectories import corrected
from magmatch.slam.windows import Path
from magmatch.typing import Vector3


@dataclass(eq=False)
class Session:
    """Logs, the graph that ties them, and what follows from it."""

    paths: list[Path]
    graph: PoseGraph
    biases: tuple[tuple[Vector3, Vector3], ...]
    seconds: dict[str, float]

    @cached_property
    def trajectories(self) -> list[Survey]:
        """Each log with corrected positions, orientations and field, in the frame of its component."""
        return [corrected(path, self.graph) for path in self.paths]

    @cached_property
    def components(self) -> list[list[int]]:
        """Logs that share a frame, the component with the longest path first."""
        root = self.graph.component()[[path.first_node for path in self.paths]]
        groups = [np.flatnonzero(root == r).tolist() for r in np.unique(root)]
        return sorted(groups, key=lambda logs: -sum(self.paths[k].walked[-1] for k in logs))

    def map(self, component: int = 0, config: FieldConfig | None = None) -> FieldMap:
        """One map of all logs of a component."""
        return build_map([self.trajectories[k] for k in self.components[component]], config)
