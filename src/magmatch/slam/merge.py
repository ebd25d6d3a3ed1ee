# SPDX-License-Identifier: BSD-3-Clause
"""Rigid surveys into one frame: registration of all pairs, and one graph with a node for each."""

import logging
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.arguments import expect_kind, whole_number_of
from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError
from magmatch.field.map import FieldMap
from magmatch.geometry import path_walked, rotation_matrix
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig, settings_of
from magmatch.registration.index.map_index import prepare_index
from magmatch.registration.maps import as_map, require_target, survey_of
from magmatch.registration.register import register
from magmatch.registration.result import RegistrationResult
from magmatch.slam.config import SlamConfig
from magmatch.slam.pose_graph import Closure, Edges, PoseGraph
from magmatch.slam.session import Session
from magmatch.slam.statement import covariance_about
from magmatch.slam.windows import Path, Window
from magmatch.threads import one_blas_thread
from magmatch.typing import Points

log = logging.getLogger(__name__)

# No probability is nearer to one than this: odds stay finite.
LEAST_DOUBT = 1e-12


def merge(
    surveys: Sequence[Survey | FieldMap], config: RegistrationConfig | None = None, *, seed: int = 0
) -> Session:
    """Bring surveys of one place, each rigid in a frame of its own, into one frame.

    Every pair is registered. What is accepted ties the two; what contradicts the others loses its weight.

    Parameters
    ----------
    surveys : sequence of Survey or FieldMap
        At least two.
    config : RegistrationConfig, optional
        Of the registration of each pair.
    seed : int
        Same input, configuration and seed give the same answer bit for bit.

    Returns
    -------
    Session
        Surveys in the frame of their component; those that nothing ties stay in one of their own.

    Raises
    ------
    SurveyError
        A survey holds NaN, impossible values or too few samples.
    """
    config, given = settings_of(config), _several(surveys)
    whole_number_of(seed, "seed")
    if config.search == "keypoints":
        msg = "merge: the published method states no covariance, which the graph needs; take another preset"
        raise ConfigurationError(msg)
    clock = Clock()
    with one_blas_thread():
        with clock("maps"):
            maps = [as_map(survey, config.field) for survey in given]
        samples = [survey_of(survey) for survey in given]
        paths = [_rigid(survey, k) for k, survey in enumerate(samples)]
        graph = _unconnected(np.stack([survey.centroid for survey in samples]))
        with clock("registration"):
            graph.closures = _register_pairs(given, maps, config, seed)
        with clock("graph"):
            _lay_out(graph)
            graph.solve()
    return Session(samples, paths, graph, config, (), clock.seconds(), seed, is_rigid=True)


def _several(surveys: Sequence[Survey | FieldMap]) -> list[Survey | FieldMap]:
    expect_kind(surveys, "surveys", (list, tuple), {"Survey": "merge([a, b, c]) takes several"})
    if len(surveys) < 2:
        msg = f"expected at least two surveys to merge, got {len(surveys)}"
        raise ValueError(msg)
    for survey in surveys:
        require_target(survey)
    return list(surveys)


def _register_pairs(
    given: Sequence[Survey | FieldMap], maps: Sequence[FieldMap], config: RegistrationConfig, seed: int
) -> list[Closure]:
    """Closures between all pairs that registration accepts; each base is prepared once."""
    closures: list[Closure] = []
    n_pairs = len(maps) * (len(maps) - 1) // 2
    index = None
    for n, (a, b) in enumerate(combinations(range(len(maps)), 2)):
        if index is None or index.field_map is not maps[a]:
            index = prepare_index(maps[a], config)
        log.info("pair %d of %d: %s and %s", n + 1, n_pairs, maps[a].survey.name, maps[b].survey.name)
        result = register(index, maps[b], config, seed=seed)
        log.info("%s", result.reason)
        if result.is_accepted:
            closures.append(_closure(a, b, result, survey_of(given[a]), survey_of(given[b])))
    return closures


def _closure(a: int, b: int, result: RegistrationResult, base: Survey, target: Survey) -> Closure:
    """A registration as a tie between centroids: about its frame's origin, far away, a turn would be a shift."""
    assert result.T_base_target is not None
    assert result.covariance is not None
    assert result.probability is not None
    T = RigidTransform.from_translation(-base.centroid) * result.T_base_target
    T = T * RigidTransform.from_translation(target.centroid)
    p = min(result.probability, 1 - LEAST_DOUBT)
    odds = float(np.log(p / (1 - p)))
    return Closure(a, b, T, covariance_about(result.covariance, target.centroid), odds)


def _rigid(survey: Survey, k: int) -> Path:
    """A survey as one window, its node at the centroid."""
    walked = path_walked(survey.positions)
    config = SlamConfig(is_gravity_aligned=False)
    window = Window(k, k, survey, survey.centroid, max(float(walked[-1]), 1e-9), config)
    return Path(survey, walked, np.zeros(len(survey), np.int64), (window,), np.zeros(1, np.int64), k)


def _unconnected(centers: Points) -> PoseGraph:
    """A node for each survey, without odometry."""
    none = np.zeros(0, dtype=np.int64)
    edges = Edges(none, none, np.zeros((0, 3)), np.zeros((0, 6, 6)), np.zeros((0, 6, 2)), none)
    n = len(centers)
    config = SlamConfig(is_gravity_aligned=False)
    return PoseGraph(config, np.tile(np.eye(3), (n, 1, 1)), centers.copy(), np.arange(n), edges)


def _lay_out(graph: PoseGraph) -> None:
    """Where the surest closures put the surveys: least squares must begin near its answer."""
    group = np.arange(len(graph.p))
    R, p = graph.R.copy(), graph.p.copy()
    for c in sorted(graph.closures, key=lambda c: -c.log_odds):
        a, b = group[c.first], group[c.second]
        if a == b:
            continue
        # The later group moves as a whole: the first survey of a component keeps its own frame.
        moves, stays = (b, a) if a < b else (a, b)
        T_first, T_second = (
            RigidTransform.from_components(p[k], Rotation.from_matrix(R[k])) for k in (c.first, c.second)
        )
        T = T_first * c.T_first_second * T_second.inv()
        T = T if moves == b else T.inv()
        moved = group == moves
        p[moved] = T.apply(p[moved])
        R[moved] = rotation_matrix(T) @ R[moved]
        group[moved] = stays
    graph.R, graph.p = R, p
