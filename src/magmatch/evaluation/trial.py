# SPDX-License-Identifier: BSD-3-Clause
"""One trial: a pure function of experiment, method and seed (all but its seconds and bytes)."""

import logging
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.evaluation.cost import MapShelf, measured
from magmatch.evaluation.experiment import Experiment, Pair
from magmatch.evaluation.fingerprint import fingerprint
from magmatch.evaluation.method import Method, Task
from magmatch.evaluation.rows import Row
from magmatch.geometry import log_se3, transform_error
from magmatch.registration.result import RegistrationResult

log = logging.getLogger(__name__)

# How rough the start of methods that only refine is: what a floor plan and a compass give.
ROUGH_ANGLE_DEG, ROUGH_DISTANCE = 10.0, 0.3
ROUGH_WORDS = f"started {ROUGH_ANGLE_DEG:.0f} deg and {ROUGH_DISTANCE} m off the truth"
FAULT = "fault"


@dataclass(frozen=True, slots=True)
class Batch:
    """Trials of one pair: the unit of work, whose rows are kept together.

    Attributes
    ----------
    experiment : Experiment
    seed : int
    methods : tuple of Method
    recordings : Path or None
        Folder of public recordings; None: the cache.
    """

    experiment: Experiment
    seed: int
    methods: tuple[Method, ...]
    recordings: Path | None = None


def run_batch(batch: Batch) -> list[Row]:
    """Make the pair once and ask every method.

    Parameters
    ----------
    batch : Batch

    Returns
    -------
    list of Row
        In the order of the methods.
    """
    pair, shelf = batch.experiment.make(batch.seed, batch.recordings), MapShelf()
    task = Task(pair.base, pair.target, batch.seed, rough_start(pair, batch.seed), shelf.build)
    return [_row(batch, method, pair, task, shelf) for method in batch.methods]


def digest_of(experiment: Experiment, method: Method) -> str:
    """Fingerprint of all that a row depends on besides its seed: settings and code."""
    return fingerprint(repr(experiment.make), repr(method))


def rough_start(pair: Pair, seed: int) -> RigidTransform:
    """Give the truth, turned and shifted at the target's place by a known amount in a random direction."""
    rng = np.random.default_rng([seed, 1])
    axis, way = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    center = pair.target.centroid
    turn = Rotation.from_rotvec(np.radians(ROUGH_ANGLE_DEG) * axis)
    shift = center + ROUGH_DISTANCE * way - turn.apply(center)
    return pair.T_base_target * RigidTransform.from_components(shift, turn)


def _row(batch: Batch, method: Method, pair: Pair, task: Task, shelf: MapShelf) -> Row:
    log.info("%s, seed %d: %s", batch.experiment.name, batch.seed, method.name)
    outcome, own = measured(_attempt, method, task)
    cost = shelf.charge(own)
    distance, angle = math.inf, math.inf
    if isinstance(outcome, str):
        status, reason, nees, is_accepted = FAULT, outcome, math.nan, False
    else:
        status, reason, is_accepted = str(outcome.status), outcome.reason, outcome.is_accepted
        pose, nees = outcome.best_pose, nees_of(outcome, pair.T_base_target)
        if pose is not None:
            distance, angle = transform_error(pose, pair.T_base_target, pair.target.centroid)
    return Row(
        experiment=batch.experiment.name,
        method=method.name,
        seed=batch.seed,
        digest=digest_of(batch.experiment, method),
        status=status,
        reason=reason,
        is_accepted=is_accepted,
        is_there=pair.accept,
        distance=distance,
        angle=angle,
        nees=nees,
        n_base=len(pair.base),
        n_target=len(pair.target),
        seconds=cost.seconds,
        peak_bytes=cost.peak_bytes,
    )


def _attempt(method: Method, task: Task) -> RegistrationResult | str:
    """Ask a method; one that breaks down has failed, in words, and the others go on."""
    try:
        return method(task)
    except MemoryError:
        raise
    except Exception as error:
        log.warning("%s broke down: %s: %s", method.name, type(error).__name__, error)
        return f"{type(error).__name__}: {' '.join(str(error).split())}"


def nees_of(result: RegistrationResult, T_true: RigidTransform) -> float:
    """Squared error over its stated covariance, per degree of freedom; NaN where none is stated.

    Parameters
    ----------
    result : RegistrationResult
    T_true : RigidTransform

    Returns
    -------
    float
        1 on average where the covariance is right.
    """
    if result.T_base_target is None or result.covariance is None:
        return math.nan
    xi = log_se3(result.T_base_target.inv() * T_true)
    return float(xi @ np.linalg.solve(result.covariance, xi)) / 6
