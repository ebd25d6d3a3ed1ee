# SPDX-License-Identifier: BSD-3-Clause
"""One trial: a pure function of experiment, method, seed and code (all but its seconds and bytes)."""

import hashlib
import logging
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

import magmatch
import magmatch_evaluation
from magmatch.geometry import transform_error
from magmatch.registration.result import RegistrationResult
from magmatch_evaluation.cost import Cost, MapShelf, measured
from magmatch_evaluation.experiments import Experiment
from magmatch_evaluation.held_out_field import HeldOut
from magmatch_evaluation.methods import Method, MethodInput
from magmatch_evaluation.rows import AnyRow, Key, MapRow, Row
from magmatch_evaluation.survey_pairs import SurveyPair

log = logging.getLogger(__name__)

FAULT = "fault"
# Rooms that show and drive but do not compute.
WITHOUT_INFLUENCE = ("cli", "viz")


@dataclass(frozen=True, slots=True)
class Batch:
    """Trials of one pair: the unit of work, whose rows are kept together."""

    experiment: Experiment
    seed: int
    methods: tuple[Method, ...]
    recordings: Path | None = None

    def row_keys(self) -> list[Key]:
        """Keys of the rows that it gives, in the order of the methods."""
        made = repr(self.experiment.make)
        return [(self.experiment.name, m.name, self.seed, fingerprint(made, repr(m))) for m in self.methods]


def run_batch(batch: Batch) -> list[AnyRow]:
    """Make the pair once and ask every method."""
    made, shelf = batch.experiment.make(batch.seed, batch.recordings), MapShelf()
    subject: Any = made
    if isinstance(made, SurveyPair):
        subject = MethodInput(made.base, made.target, batch.seed, made.rough_start(batch.seed), shelf.build)
    rows: list[AnyRow] = []
    for method, key in zip(batch.methods, batch.row_keys(), strict=True):
        log.info("%s, seed %d: %s", batch.experiment.name, batch.seed, method.name)
        outcome, own = measured(_attempt, method, subject)
        cost = shelf.charge(own)
        rows.append(_map_row(key, outcome, cost) if isinstance(made, HeldOut) else _row(key, made, outcome, cost))
    return rows


def nees_of(result: RegistrationResult, T_true: RigidTransform) -> float:
    """Squared error over its stated covariance, per degree of freedom; NaN where none is stated."""
    if result.T_base_target is None or result.covariance is None:
        return math.nan
    xi = (result.T_base_target.inv() * T_true).as_exp_coords()
    return float(xi @ np.linalg.solve(result.covariance, xi)) / 6


def fingerprint(*settings: str) -> str:
    """Short digest of settings and of all code that results depend on: rows of others are never taken for today's."""
    return hashlib.sha256("\0".join([*settings, code_digest()]).encode()).hexdigest()[:16]


@cache
def code_digest() -> str:
    """Digest of the source of the package and of the baselines."""
    package, baselines = Path(magmatch.__file__).parent, Path(magmatch_evaluation.__file__).parent / "baselines"
    digest = hashlib.sha256()
    for folder in (package, baselines):
        for path in sorted(folder.rglob("*.py")):
            place = path.relative_to(folder)
            if place.parts[0] not in WITHOUT_INFLUENCE:
                digest.update(place.as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _attempt(method: Method, subject: Any) -> Any:
    """Ask a method; one that breaks down has failed, in words, and the others go on."""
    try:
        return method(subject)
    except MemoryError:
        raise
    except Exception as error:
        log.warning("%s broke down: %s: %s", method.name, type(error).__name__, error)
        return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _map_row(key: Key, outcome: tuple[float, float, float] | str, cost: Cost) -> MapRow:
    if isinstance(outcome, str):
        return MapRow(*key, outcome, math.nan, math.nan, math.nan, cost.seconds)
    return MapRow(*key, "", *outcome, cost.seconds)


def _row(key: Key, pair: SurveyPair, outcome: RegistrationResult | str, cost: Cost) -> Row:
    distance, angle, nees = math.inf, math.inf, math.nan
    if isinstance(outcome, str):
        said = (FAULT, outcome, False)
    else:
        said = (str(outcome.status), outcome.reason, outcome.is_accepted)
        nees = nees_of(outcome, pair.T_base_target)
        if outcome.best_pose is not None:
            distance, angle = transform_error(outcome.best_pose, pair.T_base_target, pair.target.centroid)
    sizes = len(pair.base), len(pair.target)
    return Row(*key, *said, pair.accept, distance, angle, nees, *sizes, cost.seconds, cost.peak_bytes)
