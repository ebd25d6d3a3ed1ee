# SPDX-License-Identifier: BSD-3-Clause
"""Rigid surveys in one frame: registration of all pairs, and a graph with a node for each survey."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, pairwise, product
from pathlib import Path as FilePath

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import expit

from magmatch.arguments import expect_kind, whole_number_of
from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError
from magmatch.field.map import FieldMap
from magmatch.geometry import covariance_about, path_walked, rotation_matrix
from magmatch.progress import Progress, counted, followed
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig, settings_of
from magmatch.registration.index.map_index import MapIndex, prepare_index
from magmatch.registration.maps import as_map, require_target, survey_of
from magmatch.registration.register import register
from magmatch.runner import Runner, Shared, Workers
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.factors import Closure
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.solve import solve
from magmatch.slam.places import Places
from magmatch.slam.session import Session, require_distinct, unique_stems
from magmatch.slam.windows import Path, Window, mean_field
from magmatch.threads import one_blas_thread
from magmatch.typing import Covariance6, Points
from magmatch.workers import Task

log = logging.getLogger(__name__)

# No probability is nearer to one than this: odds stay finite.
LEAST_ERROR = 1e-12
# An accepted registration: T_base_target, its covariance and probability.
Registered = tuple[RigidTransform, Covariance6, float]
# To which readings and steps agree that are the same, T and m: far above rounding, far below any noise.
SAME_FIELD, SAME_PLACE = 1e-13, 1e-6
# Trees of closures tried for a start.
N_TREES = 64
# Surveys have no odometry, and lie anyhow.
RIGID = SlamConfig(is_gravity_aligned=False)


def merge(
    surveys: Sequence[Survey | FieldMap],
    config: RegistrationConfig | None = None,
    *,
    seed: int = 0,
    run: Workers | None = None,
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
    config = settings_of(config)
    expect_kind(surveys, "surveys", (list, tuple), {"Survey": "merge([a, b, c]) takes several"})
    if len(surveys) < 2:
        msg = f"expected at least two surveys to merge, got {len(surveys)}"
        raise ValueError(msg)
    for k, survey in enumerate(surveys):
        require_target(survey, f"surveys[{k}]")
    whole_number_of(seed, "seed")
    if config.search == "keypoints":
        msg = "merge: the published method states no covariance, which the graph needs; take another preset"
        raise ConfigurationError(msg)
    samples, clock = [survey_of(survey) for survey in surveys], Clock()
    require_distinct(samples)
    _warn_of_shared_logs(surveys)
    with followed(progress), one_blas_thread(), Runner(run, keep) as runner:
        with clock("maps"):
            maps = [as_map(survey, config.field) for survey in counted("mapping", surveys)]
        paths = [_rigid(survey, k) for k, survey in enumerate(samples)]
        graph = _unconnected(np.stack([survey.centroid for survey in samples]))
        with clock("registration"):
            graph.closures = _register_pairs(maps, samples, config, seed, runner)
        with clock("graph"):
            _lay_out(graph)
            solve(graph)
    return Session(config, samples, Places(paths, graph, RIGID, is_rigid=True), clock.seconds(), seed)


def _warn_of_shared_logs(given: Sequence[Survey | FieldMap]) -> None:
    """Say so where two maps were made from a log in common: its samples agree with themselves, and count twice."""
    steps = [[(survey.name, _steps_of(survey)) for survey in _logs_of(one)] for one in given]
    for (a, of_a), (b, of_b) in combinations(zip(given, steps, strict=True), 2):
        # Each map leaves out a few outliers of its own.
        both = [name for (name, x), (_, y) in product(of_a, of_b) if 2 * len(x & y) > min(len(x), len(y))]
        if both:
            said = "%s and %s hold the same samples (%s): these count twice, and agree with themselves"
            log.warning(said, survey_of(a).name, survey_of(b).name, both[0])


def _steps_of(survey: Survey) -> set[bytes]:
    """The field's magnitude before and after each step, and the step's length, which no turn of a frame changes."""
    field = np.linalg.norm(survey.field, axis=1) / SAME_FIELD
    steps = np.linalg.norm(np.diff(survey.positions, axis=0), axis=1) / SAME_PLACE
    return {row.tobytes() for row in np.column_stack([field[:-1], field[1:], steps]).round().astype(np.int64)}


def _logs_of(one: Survey | FieldMap) -> list[Survey]:
    """The logs of a survey or map as they were measured: each map takes out what it found of their biases."""
    if isinstance(one, Survey):
        return [one]
    ends = np.cumsum([0, *map(len, one.surveys)])
    rows = np.arange(ends[-1])
    parts = [one.measured.subset((rows >= a) & (rows < b)) for a, b in pairwise(ends)]
    return [replace(part, name=survey.name) for part, survey in zip(parts, one.surveys, strict=True)]


def _register_pairs(
    maps: Sequence[FieldMap], samples: Sequence[Survey], config: RegistrationConfig, seed: int, run: Runner
) -> list[Closure]:
    """Closures between all pairs that registration accepts."""
    pairs, names = list(combinations(range(len(maps)), 2)), unique_stems([survey.name for survey in samples])
    bases = [Shared(prepare_index, (one,), len(survey)) for one, survey in zip(maps, samples, strict=True)]
    tasks = [Task(f"{names[a]} and {names[b]}", (bases[a], maps[b], config, seed)) for a, b in pairs]
    closures: list[Closure] = []
    for (a, b), found in zip(pairs, run(_register, tasks, "registering pairs"), strict=True):
        log.info("%s and %s: %s", names[a], names[b], "not connected" if found is None else "connected")
        if found is None:
            continue
        T_base_target, covariance, probability = found
        # Between centroids: about its frame's origin, far away, a turn would be a shift.
        T_a, T_b = (RigidTransform.from_translation(x) for x in (-samples[a].centroid, samples[b].centroid))
        p, C = min(probability, 1 - LEAST_ERROR), covariance_about(covariance, samples[b].centroid)
        closures.append(Closure(a, b, T_a * T_base_target * T_b, C, float(np.log(p / (1 - p)))))
    return closures


def _register(base: MapIndex, target: FieldMap, config: RegistrationConfig, seed: int) -> Registered | None:
    """Register a pair; None if it is refused."""
    result = register(base, target, config, seed=seed)
    log.info("%s", result.reason)
    if not result.is_accepted:
        return None
    assert result.T_base_target is not None
    assert result.covariance is not None
    assert result.probability is not None
    return result.T_base_target, result.covariance, result.probability


def _rigid(survey: Survey, k: int) -> Path:
    """A survey as one window, its node at the centroid."""
    walked = path_walked(survey.positions)
    window = Window(k, k, survey, survey.centroid, max(float(walked[-1]), 1e-9), RIGID, mean_field(survey))
    number, none = np.zeros(len(survey), np.int64), np.zeros(0, np.int64)
    return Path(survey, walked, number, (window,), np.zeros(1, np.int64), k, none)


def _unconnected(centers: Points) -> PoseGraph:
    """A node for each survey, without odometry."""
    n = len(centers)
    return PoseGraph(RIGID, np.tile(np.eye(3), (n, 1, 1)), centers.copy(), np.arange(n))


def _lay_out(graph: PoseGraph) -> None:
    """Set initial poses of the surveys by closures that agree: least squares must start near the solution.

    Of the spanning tree of the most probable closures and many random ones, the tree is chosen with which most
    closures agree. From a compromise between right and wrong closures, all would seem wrong.
    """
    rng, n = np.random.default_rng(0), len(graph.p)
    odds = graph.as_arrays.odds
    best, most = None, -np.inf
    for k in range(N_TREES if n > 2 else 1):
        order = np.argsort(-odds if k == 0 else rng.permutation(len(odds)), kind="stable")
        poses = _tree(graph, [graph.closures[c] for c in order])
        # Along a tree errors add up: a closure outside it is off by those of up to n.
        log_odds = odds - 0.5 * np.maximum(_squares(graph.closures, poses) / n - 6.0, 0.0)
        if (agreed := float(np.logaddexp(0.0, log_odds).sum())) > most:
            best, most = (poses, log_odds), agreed
    if best is not None and graph.closures:
        poses, log_odds = best
        graph.R, graph.p = np.stack([rotation_matrix(T) for T in poses]), np.stack([T.translation for T in poses])
        graph.weigh_closures(expit(log_odds))


def _squares(closures: Sequence[Closure], poses: Sequence[RigidTransform]) -> np.ndarray:
    """Normalised squared error of each closure between these poses."""
    off = [(c.T_first_second.inv() * poses[c.first].inv() * poses[c.second]).as_exp_coords() for c in closures]
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
