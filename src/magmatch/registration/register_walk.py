# SPDX-License-Identifier: BSD-3-Clause
"""The verb for walks: a line of samples and a map in, one transform or a reasoned refusal out."""

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from magmatch.data.survey import Survey
from magmatch.registration.decide.walk_answer import WalkDecisionConfig, by_line_evidence
from magmatch.registration.prepared.path_noise import PathNoise, learn_path_noise
from magmatch.registration.prepared.pose_prior import PosePriorConfig, pose_prior
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.prepared.walk import Walk, walk_of
from magmatch.registration.result import RegistrationResult
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.search.pair_search import PairSearchConfig, PairTable, pair_search, tabulate_pairs
from magmatch.registration.weigh.line_evidence import LineConfig, LineEvidence, weigh_walk


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
    length : float, m
        Its field length.
    noise : PathNoise
        What residuals of another walk look like.
    """

    base: PreparedMap
    length: float
    noise: PathNoise
    table: PairTable


def index_walks(base: PreparedMap, config: WalkConfig, rng: np.random.Generator) -> WalkIndex:
    """Learn the residuals' covariance and list the base's pairs of points, once for all walks."""
    length = base.correlation_length
    noise = learn_path_noise(base.field_map, length, rng)
    return WalkIndex(base, length, noise, tabulate_pairs(base, length, noise.total_sd, config.search))


@dataclass(frozen=True, eq=False, slots=True)
class WeighedWalk:
    """A walk's poses in one base map, weighed but not judged.

    Attributes
    ----------
    found : SearchResult
        Counts of the search.
    ranked : list of LineEvidence
        Best first.
    """

    index: WalkIndex
    walk: Walk
    found: SearchResult
    ranked: list[LineEvidence]

    @property
    def log_density(self) -> float:
        """Of the walk's field under the best pose, comparable between bases, nats; -inf where there is no pose."""
        return self.ranked[0].log_density if self.ranked else -np.inf


def register_walk(
    index: WalkIndex,
    target: Survey,
    config: WalkConfig,
    rng: np.random.Generator,
    prior: PosePriorConfig | None = None,
) -> RegistrationResult:
    """Search by pairs of points, refine and weigh by generalised least squares, decide."""
    walk = walk_of(target, index.length)
    weighed = search_walk(index, walk, config, rng, prior or PosePriorConfig(), index.base.raster.volume)
    return judge_walk(weighed, config)


def search_walk(
    index: WalkIndex,
    walk: Walk,
    config: WalkConfig,
    rng: np.random.Generator,
    prior: PosePriorConfig,
    volume: float,
) -> WeighedWalk:
    """Search by pairs of points, refine and weigh by generalised least squares.

    Parameters
    ----------
    index : WalkIndex
    walk : Walk
    config, rng, prior
        As of `register_walk`.
    volume : float, m^3
        Of the regions in which the walk is looked for, this base's or those of many.

    Returns
    -------
    WeighedWalk
    """
    known = pose_prior(prior, index.base.T_map_model, walk.T_survey_walk, volume)
    found = pair_search(index.base, index.table, walk, known, config.search, rng)
    starts = [c.T_base_target for c in found.candidates]
    ranked = weigh_walk(index.base, walk, starts, index.noise, index.length, known, config.evidence)
    return WeighedWalk(index, walk, found, ranked)


def judge_walk(weighed: WeighedWalk, config: WalkConfig, lead: float = np.inf) -> RegistrationResult:
    """Accept or refuse the best pose.

    Parameters
    ----------
    weighed : WeighedWalk
    config : WalkConfig
    lead : float, nats
        Over the best pose in any other map.

    Returns
    -------
    RegistrationResult
    """
    index = weighed.index
    return by_line_evidence(
        index.base, weighed.walk, weighed.found, weighed.ranked, index.length, config.decision, lead
    )
