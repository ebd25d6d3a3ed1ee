# SPDX-License-Identifier: BSD-3-Clause
"""The verb for walks: a line of samples and a map in, one transform or a reasoned refusal out."""

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from magmatch.data.survey import Survey
from magmatch.registration.line_evidence import LineConfig, weigh_walk
from magmatch.registration.pair_search import PairSearchConfig, PairTable, pair_search, tabulate_pairs
from magmatch.registration.path_noise import PathNoise, learn_path_noise
from magmatch.registration.prepared import PreparedMap
from magmatch.registration.result import RegistrationResult
from magmatch.registration.walk import field_length, walk_of
from magmatch.registration.walk_answer import WalkDecisionConfig, by_line_evidence


class WalkConfig(BaseModel):
    """Everything that shapes the registration of a walk, stage by stage."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    search: PairSearchConfig = Field(default_factory=PairSearchConfig)
    evidence: LineConfig = Field(default_factory=LineConfig)
    decision: WalkDecisionConfig = Field(default_factory=WalkDecisionConfig)


@dataclass(frozen=True, eq=False, slots=True)
class WalkIndex:
    """What any number of walks need of one base map.

    Attributes
    ----------
    base : PreparedMap
    length : float, m
        Its field length.
    noise : PathNoise
        What residuals of another walk look like.
    table : PairTable
    """

    base: PreparedMap
    length: float
    noise: PathNoise
    table: PairTable


def index_walks(base: PreparedMap, config: WalkConfig, rng: np.random.Generator) -> WalkIndex:
    """Learn the residuals' covariance and list the base's pairs of points, once for all walks.

    Parameters
    ----------
    base : PreparedMap
    config : WalkConfig
    rng : numpy Generator
        Posterior draws.

    Returns
    -------
    WalkIndex
    """
    length = field_length(base)
    noise = learn_path_noise(base.field_map, length, rng)
    return WalkIndex(base, length, noise, tabulate_pairs(base, length, noise.total_sd, config.search))


def register_walk(
    index: WalkIndex, target: Survey, config: WalkConfig, rng: np.random.Generator
) -> RegistrationResult:
    """Search by pairs of points, refine and weigh by generalised least squares, decide.

    Parameters
    ----------
    index : WalkIndex
    target : Survey
        A line of samples in the order they were taken.
    config : WalkConfig
    rng : numpy Generator
        Draws the walk's pairs.

    Returns
    -------
    RegistrationResult
    """
    walk = walk_of(target, index.length)
    found = pair_search(index.base, index.table, walk, config.search, rng)
    starts = [c.T_base_target for c in found.candidates]
    ranked = weigh_walk(index.base, walk, starts, index.noise, index.length, config.evidence)
    return by_line_evidence(index.base, walk, found, ranked, index.length, config.decision)
