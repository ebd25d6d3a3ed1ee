# SPDX-License-Identifier: BSD-3-Clause
"""`simulate`: a named scenario in, two surveys and the exact transform between them out."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from magmatch._version import __version__
from magmatch.arguments import expect_kind
from magmatch.atomic import write_whole
from magmatch.data.survey import Survey
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.magnets import Source, field_of
from magmatch.simulation.paths import SensorPath
from magmatch.simulation.scenarios import build_scene
from magmatch.simulation.scene import SimulatedPair, Streams
from magmatch.typing import Points, Vector3, Vectors


def simulate(scenario: str, seed: int = 0, config: SimulationConfig | None = None) -> SimulatedPair:
    """Two surveys of a named scenario, each in its own frame, and the exact transform between them.

    Parameters
    ----------
    scenario : str
        One of `magmatch.simulation.SCENARIOS`, such as ``'office'``, ``'table'`` or ``'nowhere'``.
    seed : int
        Same scenario, seed and config give the same numbers bit for bit; the noise of base and target differs.
    config : SimulationConfig, optional
        Settings; the defaults suit every scenario.

    Returns
    -------
    SimulatedPair
        Base, target, ``T_base_target`` and whether a correct program accepts a registration.

    Raises
    ------
    ConfigurationError
        No such scenario (the message lists them), or a setting that does not fit it.
    MissingExtraError
        Magpylib is not installed.

    Examples
    --------
    >>> pair = simulate("uniform", seed=1, config=SimulationConfig(n_samples=10))
    >>> len(pair.target), pair.accept
    (10, False)
    """
    expect_kind(seed, "seed", (int, np.integer))
    config = SimulationConfig() if config is None else config
    expect_kind(config, "config", (SimulationConfig,))
    streams = Streams(seed)
    scene = build_scene(scenario, config, streams)
    drift = config.pose_drift if scene.is_blind else 0.0
    as_base = config.model_copy(update={"bias": (0.0, 0.0, 0.0), "scale": 0.0, "pose_drift": drift})
    as_target = config.model_copy(update={"pose_drift": drift})
    base = measure(scene.base_path, scene.base_sources, scene.earth_field, as_base, streams.base_errors)
    target = measure(scene.target_path, scene.target_sources, scene.earth_field, as_target, streams.target_errors)
    return SimulatedPair(
        scenario=scenario,
        seed=seed,
        base=replace(base.transformed(scene.T_base_world, "base"), name=f"{scenario} base"),
        target=replace(target.transformed(scene.T_target_world, "target"), name=f"{scenario} target"),
        T_base_target=scene.T_base_target,
        accept=scene.accept,
        config=config,
    )


def measure(
    path: SensorPath, sources: tuple[Source, ...], earth_field: Vector3, config: SimulationConfig,
    rng: np.random.Generator,
) -> Survey:  # fmt: skip
    """Measure along a path, world frame: the field where the sensor is, recorded where it thinks it is."""
    n = len(path.positions)
    # Drawn whether used or not, so that one setting does not change the others' errors.
    noise, pose_noise, steps = rng.standard_normal((n, 3)), rng.standard_normal((n, 3)), rng.standard_normal((n, 2))
    field = field_of(sources, path.positions) + earth_field
    drift, drift_sd = _drift(path.positions, steps, config.pose_drift)
    return Survey(
        positions=path.positions + config.pose_noise_sd * pose_noise + drift,
        field=_as_read(field, path, config) + config.noise_sd * noise,
        times=path.times,
        orientations=path.orientations,
        pose_sd=float(np.hypot(config.pose_noise_sd, drift_sd)),
    )


def _drift(positions: Points, steps: np.ndarray, rate: float) -> tuple[Points, float]:
    """Random walk of horizontal positions about its own mean, which the frame takes up, and its mean deviation."""
    walked = np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=1)
    walk = np.cumsum(rate * np.sqrt(walked)[:, None] * steps, axis=0)
    walk -= walk.mean(axis=0)
    # The variance of a random walk of length L about its own mean is L / 6 on average.
    return np.column_stack([walk, np.zeros(len(walk))]), rate * float(np.sqrt(walked.sum() / 6))


def _as_read(field: Vectors, path: SensorPath, config: SimulationConfig) -> Vectors:
    """Apply the sensor's scale and bias, which live in its own frame; result in the world frame."""
    bias = np.array(config.bias)
    turned = bias if path.orientations is None else path.orientations.apply(bias)
    return (1 + config.scale) * field + turned


def write_pair(pair: SimulatedPair, folder: str | Path) -> None:
    """Write ``base.csv``, ``target.csv`` and, last, ``truth.json``, each whole or not at all."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    truth = {
        "T_base_target": pair.T_base_target.as_matrix().tolist(),
        "accept": pair.accept,
        "scenario": pair.scenario,
        "seed": pair.seed,
        "version": __version__,
        "config": pair.config.model_dump(mode="json"),
    }
    pair.base.save(folder / "base.csv")
    pair.target.save(folder / "target.csv")
    write_whole(folder / "truth.json", json.dumps(truth, indent=2).encode() + b"\n")
