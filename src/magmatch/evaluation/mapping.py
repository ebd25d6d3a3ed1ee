# SPDX-License-Identifier: BSD-3-Clause
"""How well fields are mapped: each prior and peer predicts what was held out, from the same samples."""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from magmatch.baselines.interpolation import inverse_distance, local_gp, nearest_neighbour
from magmatch.data.survey import Survey
from magmatch.evaluation.cost import measured
from magmatch.evaluation.fingerprint import fingerprint
from magmatch.evaluation.recorded import load
from magmatch.evaluation.rows import MapRow, RowFile, write_csv
from magmatch.evaluation.workers import run_all, until
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.scenarios import build_scene
from magmatch.simulation.scene import Streams
from magmatch.simulation.simulate import simulate
from magmatch.typing import Points, Tensors, Vectors

log = logging.getLogger(__name__)

PRIORS = ("spline", "divergence_free", "curl_free", "harmonic")
PEERS: dict[str, Callable[[Points, Vectors, Points], Vectors]] = {
    "nearest": nearest_neighbour, "idw": inverse_distance, "local-gp": local_gp,
}  # fmt: skip
PREDICTORS = (*PRIORS, *PEERS)
# Step of differences that give a gradient where there is no formula, m.
STEP = 1e-3
# A peer that copies samples has no gradient.
WITHOUT_GRADIENT = ("nearest", "idw")
N_QUERIES = 400
ROWS, TABLE = "mapping.jsonl", "mapping.csv"


@dataclass(frozen=True, eq=False, slots=True)
class HeldOut:
    """Samples to learn from, and what is asked.

    Attributes
    ----------
    survey : Survey
    queries : (m, 3) array, m
    field : (m, 3) array, T
        True, or measured.
    gradient : (m, 3, 3) array, T/m, or None
        None where it is not known.
    is_noisy : bool
        Whether the field at the queries was measured.
    """

    survey: Survey
    queries: Points
    field: Vectors
    gradient: Tensors | None
    is_noisy: bool


@dataclass(frozen=True, slots=True)
class SimulatedField:
    """A scenario's base survey; queries in the box of its samples, `above` it where it is a plane."""

    scenario: str
    config: SimulationConfig = field(default_factory=SimulationConfig)
    above: float = 0.0

    def __call__(self, seed: int, recordings: Path | None = None) -> HeldOut:  # noqa: ARG002
        """Give samples and truth of a seed."""
        survey = simulate(self.scenario, seed, self.config).base
        scene = build_scene(self.scenario, self.config, Streams(seed))
        rng = np.random.default_rng([seed, 2])
        # Within the cloud of samples: a little off a sample drawn at random, so that no query lies in furniture.
        some = survey.positions[rng.choice(len(survey), N_QUERIES, replace=False)]
        queries = some + 0.03 * rng.standard_normal(some.shape) + [0.0, 0.0, self.above]
        gradient = differences(scene.base_field, queries)
        return HeldOut(survey, queries, scene.base_field(queries), gradient, is_noisy=False)


@dataclass(frozen=True, slots=True)
class RecordedField:
    """One recording predicts another, or the rest of itself a tenth of it in one piece (by seed)."""

    dataset: str
    training: str
    test: str | None = None
    every: int = 1

    def __call__(self, seed: int, recordings: Path | None = None) -> HeldOut:
        """Give samples and what was measured elsewhere."""
        surveys = load(self.dataset, recordings)
        survey = surveys[self.training]
        survey = survey.subset(np.arange(0, len(survey), self.every))
        if self.test is not None:
            other = surveys[self.test]
        else:
            is_out = np.arange(len(survey)) * 10 // len(survey) == (3 * seed + 2) % 10
            survey, other = survey.subset(~is_out), survey.subset(is_out)
        rows = np.linspace(0, len(other) - 1, min(len(other), 10 * N_QUERIES)).astype(int)
        return HeldOut(survey, other.positions[rows], other.field[rows], None, is_noisy=True)


@dataclass(frozen=True, slots=True)
class MappingCase:
    """One row of the mapping table; fields as of `Experiment`."""

    name: str
    title: str
    make: SimulatedField | RecordedField
    n_seeds: int
    dataset: str | None = None


@dataclass(frozen=True, slots=True)
class MapTask:
    """One seed of a case, asked of some predictors."""

    case: MappingCase
    seed: int
    predictors: tuple[str, ...]
    recordings: Path | None = None


CASES: dict[str, MappingCase] = {
    case.name: case
    for case in (
        MappingCase("map-room", "room, no source inside", SimulatedField("office-random"), 4),
        MappingCase("map-furnished", "room with furniture inside", SimulatedField("office-inside"), 4),
        MappingCase("map-plane", "0.1 m above a planar survey", SimulatedField("planar", above=0.1), 4),
        MappingCase("map-table", "table over magnets", SimulatedField("table"), 4),
        MappingCase("map-cea", "CEA, walk one predicts walk two", RecordedField("cea", "training", "test"), 1, "cea"),
        MappingCase(
            "map-jidling", "jidling, tenths left out", RecordedField("jidling", "volume", every=4), 3, "jidling"
        ),
        MappingCase("map-kok", "Kok library, tenths left out", RecordedField("kok", "library"), 3, "kok"),
    )
}


def evaluate_maps(
    tasks: Sequence[MapTask],
    folder: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    deadline: float = math.inf,
) -> list[MapRow]:
    """Run the tasks whose rows are not there yet.

    Parameters
    ----------
    tasks : sequence of MapTask
    folder : Path
        Where rows are kept.
    jobs, scheduler, deadline
        As of `magmatch.evaluation.run.evaluate`.

    Returns
    -------
    list of MapRow
        Of all tasks that are done.
    """
    folder.mkdir(parents=True, exist_ok=True)
    kept = RowFile(folder / ROWS, MapRow)
    kept.mend()
    done = {row.key for row in kept.read()}
    wanted = {_key(task, name) for task in tasks for name in task.predictors}
    todo = [
        MapTask(t.case, t.seed, left, t.recordings)
        for t in tasks if (left := tuple(name for name in t.predictors if _key(t, name) not in done))
    ]  # fmt: skip
    for k, (task, rows) in enumerate(run_all(predict_held_out, until(deadline, todo), jobs, scheduler), start=1):
        kept.append(rows)
        log.info("%d of %d mapping tasks (%s, seed %d)", k, len(todo), task.case.name, task.seed)
    found = sorted((row for row in kept.read() if row.key in wanted), key=lambda row: row.key)
    write_csv(folder / TABLE, found, MapRow)
    return found


def predict_held_out(task: MapTask) -> list[MapRow]:
    """Ask each predictor; one that breaks down says why and has no figure."""
    held_out, rows = task.case.make(task.seed, task.recordings), []
    for name in task.predictors:
        reason, figures, seconds = "", (math.nan, math.nan, math.nan), math.nan
        try:
            figures, cost = measured(errors_of, name, held_out)
            seconds = cost.seconds
        except (ValueError, np.linalg.LinAlgError, RuntimeError) as error:
            reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        rows.append(MapRow(*_key(task, name), reason, *figures, seconds))
    return rows


def errors_of(name: str, held_out: HeldOut) -> tuple[float, float, float]:
    """Root mean square errors of field and gradient, and coverage, of one predictor."""
    survey, queries = held_out.survey, held_out.queries
    gradient, coverage = None, math.nan
    if name in PEERS:
        predict = PEERS[name]
        mean = predict(survey.positions, survey.field, queries)
        if held_out.gradient is not None and name not in WITHOUT_GRADIENT:
            gradient = differences(lambda p: predict(survey.positions, survey.field, p), queries)
    else:
        field_map = build_map(survey, FieldConfig.model_validate({"prior": name}))
        values = field_map.evaluate(queries, order=1)
        mean, gradient = values.field, values.gradient
        variance = np.diagonal(field_map.covariance(queries), axis1=1, axis2=2)
        variance = variance + (field_map.hyperparameters.noise_sd**2 if held_out.is_noisy else 0.0)
        coverage = float(np.mean(np.abs(mean - held_out.field) < 1.96 * np.sqrt(variance)))
    field_rmse = float(np.sqrt(((mean - held_out.field) ** 2).sum(axis=1).mean()))
    if gradient is None or held_out.gradient is None:
        return field_rmse, math.nan, coverage
    return field_rmse, float(np.sqrt(((gradient - held_out.gradient) ** 2).sum(axis=(1, 2)).mean())), coverage


def differences(function: Callable[[Points], Vectors], points: Points) -> Tensors:
    """Gradient of a vector field by central differences.

    Parameters
    ----------
    function : callable
        (n, 3) points to (n, 3) vectors.
    points : (n, 3) array, m

    Returns
    -------
    (n, 3, 3) array, T/m
        ``[i, a, b] = dB_a / dx_b``.
    """
    steps = STEP * np.concatenate([np.eye(3), -np.eye(3)])
    # In one call: a model that is fitted on every call is fitted once.
    values = function((points + steps[:, None]).reshape(-1, 3)).reshape(6, -1, 3)
    gradient: Tensors = np.stack(list((values[:3] - values[3:]) / (2 * STEP)), axis=2)
    return gradient


def _key(task: MapTask, name: str) -> tuple[str, str, int, str]:
    return task.case.name, name, task.seed, fingerprint(repr(task.case.make), name)
