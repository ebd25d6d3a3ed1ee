# SPDX-License-Identifier: BSD-3-Clause
"""Submaps: pieces of earlier path, each mapped by itself and prepared for the search of windows in it."""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.spatial.distance import cdist

from magmatch.data.survey import Survey
from magmatch.estimation.path_noise import PathNoise
from magmatch.field.config import SPLINE
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.registration.index.map_index import WalkIndex
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.search.pair_search import PairTable, tabulate_pairs
from magmatch.runner import Shared
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.shared_hyperparameters import as_rough_as_here
from magmatch.slam.windows import Path
from magmatch.threads import single_threaded
from magmatch.typing import Indices, Mask, Points

# Windows that a submap is made for. It holds one more on either side, so that a window beside them lies inside.
TOGETHER = 2
# Posterior samples that give a submap's spread.
N_DRAWS = 6
N = TypeVar("N", int, Indices)


def submap_of(node: N, first: N) -> N:
    """First node of the submap that is made for a node's window, where the log's first node is given; or of each."""
    found: N = node - (node - first) % TOGETHER
    return found


@dataclass(frozen=True, eq=False, slots=True)
class Submap:
    """A map of some path, prepared as a base for windows."""

    survey: Survey  # its samples
    node: Indices  # (n,): node whose window each sample lies in
    index: WalkIndex

    def nodes_near(self, points: Points) -> Indices:
        """Nodes whose windows lie nearest to some points (k, 3) of the submap's frame: (k,)."""
        return np.asarray(self.node[cdist(points, self.survey.positions).argmin(axis=1)])

    def are_near(self, points: Points, nodes: Indices) -> Mask:
        """Whether each point (k, 3) lies nearest to the window of one of some nodes."""
        return np.isin(self.nodes_near(points), nodes)

    def with_noise(self, noise: PathNoise) -> "Submap":
        """Give the submap where walks have other noise."""
        return replace(self, index=replace(self.index, noise=noise))


@single_threaded
def make_submap(
    survey: Survey, node: Indices, hyperparameters: Hyperparameters, noise: PathNoise, length: float,
    is_searched: bool,
) -> Submap:  # fmt: skip
    """Map some path, and list its pairs of points if it is searched; else, poses that are given are weighed in it.

    ``length``: over which the field changes, m.
    """
    T = survey.principal_frame()
    samples = survey.transformed(T.inv())
    field_map = FieldMap(survey, fit_posterior(samples, hyperparameters, SPLINE), T, SPLINE, T, samples)
    prepared = prepare(field_map, N_DRAWS, np.random.default_rng(0))
    mean = field_map.posterior.without_factors()
    # Posterior samples are not asked for again.
    prepared = replace(
        prepared, field_map=replace(field_map, posterior=mean), posterior=mean, correlation_length=length, draws=list
    )
    table = tabulate_pairs(prepared, noise.total_sd) if is_searched else PairTable.empty(length)
    return Submap(survey, node, WalkIndex(prepared, noise, noise, table))


def table_of(submap: Submap) -> PairTable:
    """Pairs of points of a submap."""
    return submap.index.table


def volume_of(submap: Submap) -> float:
    """Volume of the region that a submap knows, m^3."""
    return submap.index.base.raster.volume


@dataclass(frozen=True, eq=False, slots=True)
class SubmapMaker:
    """Says what submaps are made of, by hyperparameters that all logs of a place share."""

    hyperparameters: Hyperparameters
    squared_gradient: float  # (T/m)^2: the mean along all paths that the hyperparameters are of
    noise: PathNoise
    length: float  # m: over which the field changes

    def piece(self, path: Path, node: int) -> Shared[Submap]:
        """Submap of the windows of two nodes, of which the first is given, with one more on either side."""
        first, last = np.searchsorted(path.number, np.array([node - 1, node + TOGETHER + 1]) - path.first_node)
        rows = np.arange(first, last)
        return self._shared(path.survey.subset(rows), path.nodes[path.number[rows]])

    def whole(self, path: Path, graph: PoseGraph) -> Shared[Submap]:
        """Submap of a whole log, as the graph has it now."""
        return self._shared(corrected(path, graph), path.nodes[path.number])

    def _shared(self, survey: Survey, node: Indices) -> Shared[Submap]:
        # Whatever else is known of them would be sent in vain.
        survey = replace(survey, times=None, orientations=None)
        hyperparameters = as_rough_as_here(self.hyperparameters, self.squared_gradient, survey, self.length)
        # The noise that is known now tells which pairs of points are listed.
        about = (survey, node, hyperparameters, self.noise, self.length, True)
        return Shared(make_submap, about, len(node))
