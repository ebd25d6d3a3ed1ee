# SPDX-License-Identifier: BSD-3-Clause
"""The mapping table: every prior on every kind of survey, with its error, its gradient's error, coverage and time.

Usage: python benchmarks/bench_priors.py [--from DIR] [--rows room ...] [--priors spline harmonic ...]
`--priors auto` takes what `prior="auto"` takes, the comparison included in its time; `--samples` for the rooms.
Run with OPENBLAS_NUM_THREADS=1; needs the extra 'simulation'. RMSE is of 3-vectors. On simulations the truth is exact
and intervals are those of the noise-free field; on recordings a part is left out and intervals include the noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.prior_choice.choose_prior import choose_prior
from magmatch.field.prior_choice.numbers import choose_numbers
from magmatch.field.priors import PRIORS
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.scenarios import INSIDE_CLEARANCE, build_scene
from magmatch.simulation.scene import Scene, Streams
from magmatch.simulation.simulate import simulate
from magmatch.simulation.structures import is_clear
from magmatch_evaluation.held_out_field import differences
from magmatch_evaluation.script import UT, arguments, rmse_ut, timed

N_QUERIES = 1500
ROOM = SimulationConfig(noise_sd=1e-6)


@dataclass(frozen=True)
class Case:
    """A survey and what is to be predicted from it: points and field, and the gradient where it is known."""

    name: str
    survey: Survey
    tests: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray | None]] = field(default_factory=dict)
    has_truth: bool = True


def truth_at(scene: Scene, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points with the exact field and, by central differences, its gradient."""
    return points, scene.base_field(points), differences(scene.base_field, points)


def rooms(n_samples: int) -> Iterator[Case]:
    """The volume of the design notes, and the same with furniture among the samples."""
    config = ROOM.model_copy(update={"n_samples": n_samples})
    for label, scenario in (("room", "office"), ("inside", "office-inside")):
        for seed in (0, 1, 2):
            scene, base = build_scene(scenario, config, Streams(seed)), simulate(scenario, seed, config).base
            world = np.random.default_rng(5).uniform(-1, 1, size=(4 * N_QUERIES, 3)) * np.array(ROOM.room_size) / 2
            # Where a sensor can be: not in the furniture, nor where its own samples keep off.
            free = is_clear(list(scene.base_sources), world, INSIDE_CLEARANCE)
            points = scene.T_base_world.apply(world[free][:N_QUERIES])
            yield Case(f"{label} {seed}", base, {"between": truth_at(scene, points)})


def planes() -> Iterator[Case]:
    """Samples at one height; truth above it."""
    for seed in (0, 1, 2):
        scene = build_scene("office", ROOM, Streams(seed))
        rng = np.random.default_rng(seed)
        world = np.c_[rng.uniform(-1.5, 1.5, (1500, 2)), -0.2 + 0.005 * rng.normal(size=1500)]
        points = scene.T_base_world.apply(world)
        survey = Survey(points, scene.base_field(points) + ROOM.noise_sd * rng.normal(size=points.shape))
        tests = {}
        for above in (0.05, 0.1, 0.2):
            at = np.c_[rng.uniform(-1.4, 1.4, (N_QUERIES, 2)), np.full(N_QUERIES, -0.2 + above)]
            tests[f"{100 * above:.0f} cm above"] = truth_at(scene, scene.T_base_world.apply(at))
        yield Case(f"plane {seed}", survey, tests)


def tables() -> Iterator[Case]:
    """Strong magnets a few centimetres away: between the rows of the base, and where the target's path goes."""
    for scenario in ("table", "table-robot"):
        for seed in (0, 1):
            config = SimulationConfig()
            scene, pair = build_scene(scenario, config, Streams(seed)), simulate(scenario, seed, config)
            there = scene.T_base_world.apply(scene.target_path.positions[:: len(pair.target) // 1000])
            yield Case(f"{scenario} {seed}", pair.base, {"target's path": truth_at(scene, there)})


def recorded(folder: Path) -> Iterator[Case]:
    """Left-out stretches of real surveys, and one walk from another."""
    jidling = next(iter(load_recordings("jidling", folder).values()))
    yield left_out("jidling", jidling.subset(np.arange(0, len(jidling), -(-len(jidling) // 6000))), 10)
    for name, survey in load_recordings("kok", folder).items():
        yield left_out(f"kok {name}", survey, 10)
    cea = load_recordings("cea", folder)
    for direction, first, second in (("1-2", "training", "test"), ("2-1", "test", "training")):
        base, other = cea[first], cea[second]
        for thin in (8, 1):
            few = base.subset(np.arange(0, len(base), thin))
            at = np.arange(0, len(other), 8)
            tests = {"other walk": (other.positions[at], other.field[at], None)}
            label = f"cea {direction}" + (f", 1 in {thin}" if thin > 1 else "")
            yield Case(label, few, tests, has_truth=False)


def left_out(name: str, survey: Survey, n_blocks: int) -> Case:
    """Every fourth of some blocks of time left out."""
    block = np.arange(len(survey)) * n_blocks // len(survey)
    out = block % 4 == 2
    return Case(
        name, survey.subset(~out), {"left out": (survey.positions[out], survey.field[out], None)}, has_truth=False
    )


def fitted(samples: Survey, name: str, T: RigidTransform):
    """Name, hyperparameters and posterior of a prior, or of the one that is chosen."""
    if name == "auto":
        config, h = choose_prior(samples, FieldConfig(prior="auto"), T)
        name, prior = f"auto: {config.prior}", PRIORS[config.prior]
    else:
        prior = PRIORS[name]
        h = choose_numbers(prior, samples, FieldConfig())
    model = prior.build(samples.positions, samples.field, h)
    return name, h, model.infer(model.observe(samples.positions, samples.field))


def measure(case: Case, name: str) -> None:
    """Print one line for each test of a case."""
    T = case.survey.principal_frame()
    (name, h, posterior), _, seconds = timed(fitted, case.survey.transformed(T.inv()), name, T)
    for label, (points, truth, gradient) in case.tests.items():
        at = T.inv().apply(points)
        values = posterior.evaluate(at, 1).rotated(T)
        said = T.rotation.as_matrix() @ posterior.covariance(at) @ T.rotation.as_matrix().T
        variance = np.diagonal(said, axis1=1, axis2=2) + (0.0 if case.has_truth else h.noise_sd**2)
        cover = np.mean(np.abs(values.field - truth) < 1.96 * np.sqrt(variance))
        slope = "     -"
        if gradient is not None:
            slope = f"{np.sqrt(((values.gradient - gradient) ** 2).sum() / (gradient**2).sum()):6.3f}"
        print(
            f"{case.name:16s} {label:13s} {name:16s} {rmse_ut(values.field, truth):7.3f} {slope} {cover:6.1%} "
            f"{seconds:6.1f}  l {h.lengthscale:.2f} m, noise {h.noise_sd / UT:.2f} uT, inflation {h.inflation:.2f}",
            flush=True,
        )


def main() -> None:
    """Print the table."""
    asked = arguments(__doc__, recordings=None, rows=[], priors=list(PRIORS), samples=ROOM.n_samples)
    print(f"{'case':16s} {'where':13s} {'prior':16s} RMSE,uT rel.grad cover  s")
    sets = [rooms(asked.samples), planes(), tables()]
    if asked.recordings:
        sets.append(recorded(asked.recordings))
    for case in (case for cases in sets for case in cases):
        if not asked.rows or case.name.startswith(tuple(asked.rows)):
            for name in asked.priors:
                measure(case, name)


if __name__ == "__main__":
    main()
