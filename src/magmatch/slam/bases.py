# SPDX-License-Identifier: BSD-3-Clause
"""Stretches of path as bases for windows: a small map of each, prepared for the search."""

from dataclasses import dataclass, replace

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.registration.index.walk_index import WalkIndex
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.search.pair_search import tabulate_pairs
from magmatch.slam.config import SlamConfig
from magmatch.typing import Indices, Vector3

# Posterior samples that give a base's spread.
N_DRAWS = 6


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

    def node_near(self, point: Vector3) -> int:
        """Node whose window lies nearest to a point of the base's frame."""
        return int(self.node[int(np.argmin(np.linalg.norm(self.survey.positions - point, axis=1)))])

    def with_noise(self, noise: PathNoise) -> "Base":
        """The same base, beside other noise of walks."""
        return replace(self, index=replace(self.index, noise=noise))


@dataclass(eq=False, slots=True)
class BaseMaker:
    """Makes bases with given hyperparameters, which all logs of a place share."""

    numbers: Hyperparameters
    noise: PathNoise
    length: float  # m: over which the field changes
    config: SlamConfig

    def make(self, survey: Survey, node: Indices) -> Base:
        """Map a stretch and list its pairs of points."""
        T, settings = survey.principal_frame(), FieldConfig(leave_out_outliers=False)
        samples = survey.transformed(T.inv())
        field_map = FieldMap(survey, fit_posterior(samples, self.numbers, settings), T, settings, T, samples)
        prepared = prepare(field_map, N_DRAWS, np.random.default_rng(0))
        prepared = replace(prepared, correlation_length=self.length)
        table = tabulate_pairs(prepared, self.length, self.noise.total_sd, self.config.search)
        return Base(survey, node, WalkIndex(prepared, self.length, self.noise, self.noise, table))
