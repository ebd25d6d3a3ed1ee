# SPDX-License-Identifier: BSD-3-Clause
"""`simulate`: a named scenario in, two surveys and the exact transform between them out."""

from dataclasses import replace

import numpy as np

from magmatch.arguments import expect_kind
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.measure import measure
from magmatch.simulation.scenarios import build_scene
from magmatch.simulation.scene import SimulatedPair, Streams


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
