# SPDX-License-Identifier: BSD-3-Clause
"""No setting lies: a change of any one changes an answer, or raises."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel, ValidationError

from magmatch.errors import ConfigurationError, MagmatchError
from magmatch.field.build import build_map
from magmatch.registration.config import PRESETS, RegistrationConfig
from magmatch.registration.index.map_index import prepare_index
from magmatch.registration.register import register
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate

FIELD = {"lengthscale": 0.6, "signal_sd": 8e-6, "noise_sd": 4e-7, "spacing": 0.4}
MAPPED = {"field": FIELD}
PAPER = {
    "search": "keypoints",
    "field": FIELD,
    "calibrate": False,
    # Refused, so that every pose found is stated.
    "keypoints": {
        "features": {"max_points": 2500},
        "consensus": {"n_samples": 3000, "n_hypotheses": 60},
        "decision": {"max_fitness": 1e-6},
    },
}
# Where an effect is looked for: scenario, seed, samples, settings of the simulation, settings of the registration.
CASES: dict[str, tuple[str, int, int, dict[str, Any], dict[str, Any]]] = {
    "room": ("office-random", 3, 250, {}, MAPPED),
    "spiked": ("office-random", 3, 400, {}, MAPPED),
    "faint": ("office-random", 5, 250, {"noise_sd": 6e-6}, MAPPED),
    "biased": ("office-random", 4, 250, {"bias": (3e-6, -3e-6, 3e-6), "scale": 0.03}, MAPPED),
    "upright": ("office-z30", 3, 250, {}, MAPPED | {"prior": {"is_gravity_aligned": True}}),
    "level": ("office-z30", 3, 250, {}, MAPPED | {"prior": {"is_planar": True}}),
    "posed": ("office-z30", 3, 250, {}, MAPPED | {"prior": {"pose": (0, 0, 0, 0, 0, 0.26, 0.966)}}),
    "paper": ("office-z30", 3, 300, {"noise_sd": 5e-6}, PAPER),
}
# Settings of a group, or one alone, show in these cases, asked in turn.
SHOWS = {
    "field.leave_out_outliers": ["spiked"],
    "prior.gravity_sd": ["upright"],
    "prior.height_sd": ["level"],
    "field": ["room", "spiked"],
    "search": ["room"],
    "prior": ["posed", "upright", "level"],
    "keypoints": ["paper"],
    "refinement": ["biased"],
    "decision": ["room", "faint"],
}
# Values that are no number times a factor, or of which one shows sooner.
WORDS: dict[str, tuple[Any, ...]] = {
    "field.prior": ("harmonic",),
    "field.lengthscale": (0.5,),
    "field.spacing": (0.45,),
    "field.domain": ((-1, -1, -1, 0.2, 1, 1),),
    "search": ("pairs",),
    "keypoints.consensus.n_samples": (3,),
    "keypoints.consensus.sample_size": (2,),
    "prior.pose": ((9, 9, 9, 0, 0, 0, 1),),
    "keypoints.features.grid": ("path",),
    "refinement.sensor.mode": ("full",),
    "keypoints.features.spacing": (0.3,),
    "keypoints.features.axes": ("principal",),
    "keypoints.features.max_variance": (1e-12,),
    "keypoints.matching.max_distance": (0.05,),
    "keypoints.features.support_radius": (3.0,),
    "keypoints.features.component_range": (1e-5,),
    # Nearly nothing allowed, and nearly certainty asked for.
    "decision.min_probability": (1 - 1e-15, 0.5),
    "decision.max_sd_translation": (1e-4,),
    "decision.max_sd_rotation": (1e-4,),
}
# Asked elsewhere: what 'auto' found, kept with the settings that it led to; settings of which the tests of their own
# stage show both sides (`test_fitness.py`, `test_sensor_calibration.py`,
# `field/test_sensor_biases.py`).
ELSEWHERE = ("field.comparison", "field.sensor_bias_sd", "keypoints.decision.", "calibrate")
FACTORS = (3, 0.3, 0.05, 1e3, 1e-3, 0.0)


def leaves(model: BaseModel, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names of all settings, with their defaults."""
    for name in type(model).model_fields:
        value = getattr(model, name)
        yield from leaves(value, f"{prefix}{name}.") if isinstance(value, BaseModel) else [(prefix + name, value)]


def others(name: str, value: Any) -> Iterator[Any]:
    """Values unlike the default."""
    if name in WORDS:
        yield from WORDS[name]
    elif isinstance(value, bool):
        yield not value
    elif isinstance(value, tuple):
        yield tuple(30 * v for v in value)
    else:
        yield from (type(value)(factor * value) for factor in FACTORS)


@cache
def pair(case):
    scenario, seed, n, simulation, _ = CASES[case]
    made = simulate(scenario, seed, SimulationConfig(n_samples=n, **simulation))
    base, target = made.base, made.target
    if case == "spiked":
        target = replace(target, field=target.field + np.where(np.arange(n) % 80, 0, 40e-6)[:, None])
    return base, target


@cache
def maps(case):
    """What does not depend on the settings in question, made once: maps, and the index of a base."""
    config = RegistrationConfig.model_validate(CASES[case][4])
    base, target = (build_map(survey, config.field) for survey in pair(case))
    return (base if config.search == "keypoints" else prepare_index(base)), target


def answer(case, config, group):
    base, target = pair(case) if group == "field" else maps(case)
    found = register(base, target, config).to_dict()
    return {key: found[key] for key in found if key not in ("seconds", "config")}


@cache
def usual(case, group):
    return answer(case, RegistrationConfig.model_validate(CASES[case][4]), group)


def changed(settings: dict[str, Any], name: str, value: Any) -> RegistrationConfig:
    document = RegistrationConfig.model_validate(settings).model_dump()
    *path, last = name.split(".")
    place = document
    for step in path:
        place = place[step]
    place[last] = value
    return RegistrationConfig.model_validate(document)


def asked() -> Iterator[Any]:
    """Give each setting; all but the first of each group take their time."""
    groups = set()
    for name, default in leaves(RegistrationConfig()):
        if not name.startswith(ELSEWHERE):
            group = name.rsplit(".", 1)[0]
            yield pytest.param(name, default, id=name, marks=[pytest.mark.slow] * (group in groups))
            groups.add(group)


@pytest.mark.parametrize(("name", "default"), list(asked()))
def test_a_setting_changes_an_answer_or_raises(name, default):
    group = name.split(".")[0]
    for case in SHOWS.get(name) or SHOWS[name.split(".")[0]]:
        value_here = dict(leaves(RegistrationConfig.model_validate(CASES[case][4])))[name]
        for value in others(name, value_here if value_here is not None else default):
            try:
                config = changed(CASES[case][4], name, value)
            except ValidationError:
                continue  # out of the setting's own bounds
            try:
                if answer(case, config, group) != usual(case, group):
                    return
            except MagmatchError:
                return
    pytest.fail(f"{name}: no value tried changes any answer")


@pytest.mark.parametrize("changed", [{"prior": {"is_planar": True}}, {"decision": {"max_sd_rotation": 0.2}}])
def test_what_the_published_method_does_not_use_is_refused(changed):
    pair = simulate("office-random", 0, SimulationConfig(n_samples=200))
    config = RegistrationConfig.model_validate(PRESETS["paper"].model_dump() | changed)
    with pytest.raises(ConfigurationError, match="search by keypoints, which use none of it"):
        register(pair.base, pair.target, config)
