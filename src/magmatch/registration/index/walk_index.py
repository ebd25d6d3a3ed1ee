# SPDX-License-Identifier: BSD-3-Clause
"""Any number of walks need this of one base map: the residuals' covariance and the pairs of points."""

from dataclasses import dataclass

import numpy as np

from magmatch.estimation.path_noise import PathNoise, learn_path_noise
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.search.pair_search import PairSearchConfig, PairTable, tabulate_pairs


@dataclass(frozen=True, eq=False, slots=True)
class WalkIndex:
    """A base map made ready for walks."""

    base: PreparedMap
    length: float  # m: the base's correlation length
    # What residuals of another walk look like, for registrations and for localisation
    noise: PathNoise
    live_noise: PathNoise
    table: PairTable


def index_walks(base: PreparedMap, config: PairSearchConfig, rng: np.random.Generator) -> WalkIndex:
    """Learn the residuals' covariance and list the base's pairs of points, once for all walks."""
    length = base.correlation_length
    noise, live_noise = learn_path_noise(base.field_map, length, rng)
    return WalkIndex(base, length, noise, live_noise, tabulate_pairs(base, length, noise.total_sd, config))
