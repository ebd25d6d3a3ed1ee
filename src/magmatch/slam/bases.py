# SPDX-License-Identifier: BSD-3-Clause
"""Stretches of path as bases for windows: a small map of each, prepared for the search."""

from dataclasses import dataclass, field, replace
from threading import Lock
from typing import TypeVar

import numpy as np
from scipy.spatial.distance import cdist

from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.registration.index.walk_index import WalkIndex
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.search.pair_search import PairTable, tabulate_pairs
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.windows import Path
from magmatch.typing import Indices, Mask, Points

# Windows that a stretch is made for. It holds one more on either side, so that a window beside them lies inside.
TOGETHER = 2
# Posterior samples that give a base's spread.
N_DRAWS = 6
# Stretches kept in memory as bases, at about a megabyte each.
MOST_BASES = 2048
N = TypeVar("N", int, Indices)
# Held by the thread that changes what is kept: stretches are made in parallel.
_keeping = Lock()


def stretch_of(node: N, first: N) -> N:
    """First node of the stretch that is made for a node's window, where the log's first node is given; or of each."""
    found: N = node - (node - first) % TOGETHER
    return found


@dataclass(frozen=True, eq=False, slots=True)
class Base:
    """A stretch of path prepared as a base for windows."""

    survey: Survey  # its samples
    node: Indices  # (n,): node whose window each sample lies in
    index: WalkIndex

    @property
    def volume(self) -> float:
        """Of the region that it knows, m^3."""
        return self.index.base.raster.volume

    def nodes_near(self, points: Points) -> Indices:
        """Nodes whose windows lie nearest to some points (k, 3) of the base's frame: (k,)."""
        return np.asarray(self.node[cdist(points, self.survey.positions).argmin(axis=1)])

    def are_near(self, points: Points, nodes: Indices) -> Mask:
        """Whether each point (k, 3) lies nearest to the window of one of some nodes."""
        return np.isin(self.nodes_near(points), nodes)


@dataclass(eq=False, slots=True)
class BaseMaker:
    """Makes bases with given hyperparameters, which all logs of a place share, and keeps those used last."""

    numbers: Hyperparameters
    noise: PathNoise
    length: float  # m: over which the field changes
    config: SlamConfig
    # By node, and the pairs of points of each that was ever made; whole logs with how many closures corrected them.
    _made: dict[int, Base] = field(default_factory=dict, init=False)
    _tables: dict[int, PairTable] = field(default_factory=dict, init=False)
    _whole: dict[int, tuple[int, Base]] = field(default_factory=dict, init=False)

    def stretch(self, path: Path, node: int) -> Base:
        """The stretch made for a node's window and others, with one more on either side, odometry's frame."""
        node = stretch_of(node, path.first_node)
        with _keeping:
            base = self._made.pop(node, None)
        if base is None:
            first, last = np.searchsorted(path.number, np.array([node - 1, node + TOGETHER + 1]) - path.first_node)
            rows = np.arange(first, last)
            base = self.make(path.survey.subset(rows), path.nodes[path.number[rows]])
        with _keeping:
            self._tables[node] = base.index.table
            # The one used last stands last.
            self._made[node] = base
            if len(self._made) > MOST_BASES:
                del self._made[next(iter(self._made))]
        return base

    def table(self, path: Path, node: int) -> PairTable:
        """Pairs of points of the stretch of a node."""
        node = stretch_of(node, path.first_node)
        if node not in self._tables:
            self.stretch(path, node)
        return self._tables[node]

    def whole(self, path: Path, graph: PoseGraph) -> Base:
        """A whole log, as the graph has it now."""
        n, base = self._whole.get(path.first_node, (-1, None))
        if base is None or n != len(graph.closures):
            base = self.make(corrected(path, graph), path.nodes[path.number])
            self._whole[path.first_node] = len(graph.closures), base
        return base

    def learn(self, noise: PathNoise) -> None:
        """Take other noise of walks, for bases that were made too."""
        self.noise = noise
        for node, base in self._made.items():
            self._made[node] = replace(base, index=replace(base.index, noise=noise))
        self._whole.clear()

    def make(self, survey: Survey, node: Indices) -> Base:
        """Map a stretch and list its pairs of points."""
        T, settings = survey.principal_frame(), FieldConfig(leave_out_outliers=False)
        samples = survey.transformed(T.inv())
        field_map = FieldMap(survey, fit_posterior(samples, self.numbers, settings), T, settings, T, samples)
        prepared = prepare(field_map, N_DRAWS, np.random.default_rng(0))
        mean = field_map.posterior.without_factors()
        prepared = replace(
            prepared,
            field_map=replace(field_map, posterior=mean),
            posterior=mean,
            correlation_length=self.length,
        )
        table = tabulate_pairs(prepared, self.length, self.noise.total_sd, self.config.search)
        return Base(survey, node, WalkIndex(prepared, self.length, self.noise, self.noise, table))
