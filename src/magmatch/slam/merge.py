# SPDX-License-Identifier: BSD-3-Clause
"""Rigid surveys in one frame: registration of all pairs, and a graph with a node for each survey."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path as FilePath

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import expit

from magmatch._version import __version__
from magmatch.arguments import expect_kind, whole_number_of
from magmatch.data.fingerprint import describe_input
from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError
from magmatch.field.map import FieldMap
from magmatch.geometry import covariance_about, log_se3, path_walked, rotation_matrix, transform_from_matrix
from magmatch.progress import Progress, counted, followed
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig, settings_of
from magmatch.registration.index.map_index import MapIndex, prepare_index
from magmatch.registration.maps import as_map, require_target, survey_of
from magmatch.registration.register import register
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.factors import Closure
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.solve import solve
from magmatch.slam.places import Places
from magmatch.slam.search.bases import Run
from magmatch.slam.session import Session, names_of, require_distinct
from magmatch.slam.steps import Steps
from magmatch.slam.windows import Path, Window, mean_field
from magmatch.threads import one_blas_thread
from magmatch.typing import Matrix, Points, Scalars
from magmatch.workers import bit_for_bit

log = logging.getLogger(__name__)

# No probability is nearer to one than this: odds stay finite.
LEAST_DOUBT = 1e-12
# Trees of closures tried for a start.
N_TREES = 64
# Of a registration: transform, covariance, probability.
N_NUMBERS = 16 + 36 + 1


def merge(
    surveys: Sequence[Survey | FieldMap],
    config: RegistrationConfig | None = None,
    *,
    seed: int = 0,
    run: Run | None = None,
    progress: Progress | None = None,
    keep: str | FilePath | None = None,
) -> Session:
    """Bring surveys of one place, each rigid in its own frame, into one frame.

    Every pair is registered. An accepted registration connects the two surveys; one that contradicts the others loses
    its weight.

    Parameters
    ----------
    surveys : sequence of Survey or FieldMap
        At least two.
    config : RegistrationConfig, optional
        Of the registration of each pair.
    seed : int
        Same input, configuration and seed give the same answer bit for bit.
    run, progress, keep
        See `slam`; other processes register the pairs.

    Returns
    -------
    Session
        Surveys in the frame of their component; unconnected ones stay in their own.

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
    samples, clock = [survey_of(survey) for survey in given], Clock()
    require_distinct(samples)
    elsewhere = None if run is None else bit_for_bit(run)
    steps = Steps(
        keep, version=__version__, config=config.model_dump(mode="json"), seed=seed,
        inputs=[describe_input(survey) for survey in samples],
        maps=[_of_map(one) if isinstance(one, FieldMap) else None for one in given],
    )  # fmt: skip
    with followed(progress), one_blas_thread():
        with clock("maps"):
            maps = [as_map(survey, config.field) for survey in counted("mapping", given)]
        paths = [_rigid(survey, k) for k, survey in enumerate(samples)]
        graph = _unconnected(np.stack([survey.centroid for survey in samples]))
        with clock("registration"):
            try:
                graph.closures = _register_pairs(maps, samples, config, seed, steps, elsewhere)
            finally:
                steps.keep()
        with clock("graph"):
            _lay_out(graph)
            solve(graph)
    return Session(config, samples, Places(paths, graph, graph.config), clock.seconds(), seed, is_rigid=True)


def _of_map(field_map: FieldMap) -> list[object]:
    """What a map is of, beside its samples."""
    T = field_map.T_domain_model.as_matrix().tolist()
    return [field_map.config.model_dump(mode="json"), asdict(field_map.hyperparameters), T]


def _several(surveys: Sequence[Survey | FieldMap]) -> list[Survey | FieldMap]:
    expect_kind(surveys, "surveys", (list, tuple), {"Survey": "merge([a, b, c]) takes several"})
    if len(surveys) < 2:
        msg = f"expected at least two surveys to merge, got {len(surveys)}"
        raise ValueError(msg)
    for k, survey in enumerate(surveys):
        require_target(survey, f"surveys[{k}]")
    return list(surveys)


@dataclass(frozen=True, eq=False, slots=True)
class _Pair:
    """Two surveys to register."""

    name: str
    base: FieldMap | MapIndex
    target: FieldMap
    config: RegistrationConfig
    seed: int
    home: int | None = None


def _register_pairs(
    maps: Sequence[FieldMap], samples: Sequence[Survey], config: RegistrationConfig, seed: int, steps: Steps,
    run: Run | None,
) -> list[Closure]:  # fmt: skip
    """Closures between all pairs that registration accepts, a step each."""
    pairs, names = list(combinations(range(len(maps)), 2)), names_of(samples)
    new = pairs[steps.n_kept :]

    def tasks() -> Iterator[_Pair]:
        index = None
        for a, b in new:
            # Each base is prepared once, or by whoever takes the pair.
            if run is None and (index is None or index.field_map is not maps[a]):
                index = prepare_index(maps[a], config)
            yield _Pair(f"{names[a]} and {names[b]}", index or maps[a], maps[b], config, seed)

    found = iter((run or map)(_register, tasks()))
    closures: list[Closure] = []
    for a, b in counted("registering pairs", pairs):
        rows = steps(lambda: next(found))
        log.info("%s and %s: %s", names[a], names[b], "tied" if len(rows) else "not tied")
        closures += [_closure(a, b, row, samples[a], samples[b]) for row in rows]
    return closures


def _register(pair: _Pair) -> Matrix:
    """A row with transform, covariance and probability of a registration; none if it is refused."""
    result = register(pair.base, pair.target, pair.config, seed=pair.seed)
    log.info("%s", result.reason)
    if not result.is_accepted:
        return np.zeros((0, N_NUMBERS))
    assert result.T_base_target is not None
    assert result.covariance is not None
    T, C = result.T_base_target.as_matrix().ravel(), result.covariance.ravel()
    return np.concatenate([T, C, [result.probability]])[None]


def _closure(a: int, b: int, row: Scalars, base: Survey, target: Survey) -> Closure:
    """A registration as a tie between centroids: about its frame's origin, far away, a turn would be a shift."""
    T = RigidTransform.from_translation(-base.centroid) * transform_from_matrix(row[:16].reshape(4, 4))
    T = T * RigidTransform.from_translation(target.centroid)
    p = min(float(row[-1]), 1 - LEAST_DOUBT)
    odds = float(np.log(p / (1 - p)))
    return Closure(a, b, T, covariance_about(row[16:-1].reshape(6, 6), target.centroid), odds)


def _rigid(survey: Survey, k: int) -> Path:
    """A survey as one window, its node at the centroid."""
    walked = path_walked(survey.positions)
    config = SlamConfig(is_gravity_aligned=False)
    window = Window(k, k, survey, survey.centroid, max(float(walked[-1]), 1e-9), config, mean_field(survey))
    number, none = np.zeros(len(survey), np.int64), np.zeros(0, np.int64)
    return Path(survey, walked, number, (window,), np.zeros(1, np.int64), k, none)


def _unconnected(centers: Points) -> PoseGraph:
    """A node for each survey, without odometry."""
    n = len(centers)
    config = SlamConfig(is_gravity_aligned=False)
    return PoseGraph(config, np.tile(np.eye(3), (n, 1, 1)), centers.copy(), np.arange(n))


def _lay_out(graph: PoseGraph) -> None:
    """Initial poses of the surveys from closures that agree: least squares must start near the solution.

    Of the spanning tree of the most probable closures and many random ones, the tree with which most closures agree
    is chosen. Starting from a compromise between right and wrong closures, all would seem wrong.
    """
    rng, n = np.random.default_rng(0), len(graph.p)
    odds = graph.ties.odds
    best, most = None, -np.inf
    for k in range(N_TREES if n > 2 else 1):
        order = np.argsort(-odds if k == 0 else rng.permutation(len(odds)), kind="stable")
        poses = _tree(graph, [graph.closures[c] for c in order])
        # Along a tree errors add up: a tie that closes it is off by those of up to n.
        doubted = odds - 0.5 * np.maximum(_squares(graph.closures, poses) / n - 6.0, 0.0)
        if (agreed := float(np.logaddexp(0.0, doubted).sum())) > most:
            best, most = (poses, doubted), agreed
    if best is not None and graph.closures:
        poses, doubted = best
        graph.R, graph.p = np.stack([rotation_matrix(T) for T in poses]), np.stack([T.translation for T in poses])
        graph.weigh_closures(expit(doubted))


def _squares(closures: Sequence[Closure], poses: Sequence[RigidTransform]) -> np.ndarray:
    """Normalised squared error of each closure between these poses."""
    off = [log_se3(c.T_first_second.inv() * poses[c.first].inv() * poses[c.second]) for c in closures]
    return np.array([xi @ np.linalg.solve(c.covariance, xi) for c, xi in zip(closures, off, strict=True)])


def _tree(graph: PoseGraph, closures: Sequence[Closure]) -> list[RigidTransform]:
    """Poses from a spanning tree of the closures, taken in their order."""
    group, poses = np.arange(len(graph.p)), [graph.pose(k) for k in range(len(graph.p))]
    for c in closures:
        a, b = int(group[c.first]), int(group[c.second])
        if a == b:
            continue
        T = poses[c.first] * c.T_first_second * poses[c.second].inv()
        # The later group moves as a whole: the first survey of a component keeps its own frame.
        moves, T = (b, T) if a < b else (a, T.inv())
        for k in np.flatnonzero(group == moves):
            poses[k] = T * poses[k]
        group[group == moves] = min(a, b)
    return poses
