# SPDX-License-Identifier: BSD-3-Clause
"""Level carriers whose magnetometers differ by a constant along the vertical."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import norm

import magmatch as mm
from dipoles import dipoles
from magmatch.estimation.model_prior import HARD_IRON_SD
from magmatch.estimation.pose_prior import UP
from magmatch.registration.refine.sensors import BIAS_LEVELS
from magmatch.registration.vertical_offset import with_vertical_offset
from magmatch.simulation.config import SimulationConfig

OFFSET = np.array([0.0, 0.0, 30e-6])
T_BASE_TARGET = RigidTransform.from_components([2.0, -1.0, 0.0], Rotation.from_euler("z", 130, degrees=True))
UPRIGHT = mm.RegistrationConfig(prior={"is_gravity_aligned": True})
REFUSED = mm.RegistrationResult(mm.Status.INCONSISTENT, "no pose", None)
FOUND = mm.RegistrationResult(mm.Status.ACCEPTED, "", T_BASE_TARGET, sensor={"bias": [1e-7, 0.0, 2e-7]})


def hall(seed: int, turn: RigidTransform, lane: float) -> mm.Survey:
    """Survey a hall in lanes, along and across, with a robot that faces where it drives."""
    rng = np.random.default_rng(seed)
    places = np.column_stack([rng.uniform(-1, 7, (60, 2)), rng.choice([-0.7, 1.6], 60)])
    moments = rng.normal(0, 2e-6, (60, 3))
    t, y = np.arange(0.0, 6.0, 0.15), np.arange(lane / 2, 6.0, lane)
    along = np.concatenate([np.column_stack([t[:: (-1) ** k], np.full(len(t), at)]) for k, at in enumerate(y)])
    x = np.column_stack([np.concatenate([along, along[:, ::-1]]), np.zeros(2 * len(along))])
    v = np.gradient(x, axis=0)
    heading = Rotation.from_euler("z", np.arctan2(v[:, 1], v[:, 0])[:, None])
    field = dipoles(x, places, moments) + rng.normal([0.0, 2e-5, -4e-5], 3e-7, x.shape)
    return mm.Survey(x, field, np.arange(len(x)) * 0.2, heading).transformed(turn)


def level_robots(base_seed: int, target_seed: int, offset: np.ndarray) -> tuple[mm.Survey, mm.Survey]:
    """Two robots' surveys of one hall, or of two, z up in both; the second one's sensor is offset along it."""
    target = hall(target_seed, T_BASE_TARGET.inv(), 1.1)
    return hall(base_seed, RigidTransform.identity(), 1.4), replace(target, field=target.field + offset)


@pytest.mark.parametrize("offset", [OFFSET / 10, OFFSET], ids=["sensors may differ so far", "far beyond"])
def test_robots_of_one_hall_are_registered_and_the_offset_is_stated(offset):
    result = mm.register(*level_robots(4, 4, offset), UPRIGHT)
    assert result.is_accepted
    xi = (result.T_base_target.inv() * T_BASE_TARGET).as_exp_coords()
    assert xi @ np.linalg.solve(result.covariance, xi) < 22.5  # one in 1,000 of six normal numbers
    assert result.sensor["bias"] == pytest.approx(offset, abs=2e-7)


def test_robots_of_different_halls_are_not_registered():
    assert not mm.register(*level_robots(4, 5, OFFSET), UPRIGHT).is_accepted


@pytest.mark.parametrize(
    ("first", "offset", "again", "is_asked", "is_taken"),
    [
        (REFUSED, OFFSET, FOUND, True, True),
        (REFUSED, -OFFSET, FOUND, True, True),
        (REFUSED, OFFSET, REFUSED, True, False),
        (REFUSED, OFFSET, None, True, False),
        (REFUSED, OFFSET / 1000, FOUND, False, False),
        (FOUND, OFFSET, FOUND, False, False),
    ],
    ids=["found", "found below", "refused again", "fails", "sensors are alike", "accepted at first"],
)
def test_it_is_looked_for_where_nothing_was_found_and_taken_where_it_is(first, offset, again, is_asked, is_taken):
    rng = np.random.default_rng(0)
    base = mm.Survey(rng.random((20, 3)), rng.normal(-40e-6, 1e-6, (20, 3)))
    target = replace(base, field=base.field + offset)
    asked = []

    def look(base, target, samples, log_prior):
        asked.append(target.field)
        return again and (base, target, again)

    found = with_vertical_offset((base, target, first), look)
    assert found[:2] == (base, target)
    assert bool(asked) == is_asked
    assert all(np.allclose(field, base.field, atol=1e-18) for field in asked)
    if is_taken:
        assert found[2].is_accepted
        assert found[2].sensor["bias"] == pytest.approx(offset + FOUND.sensor["bias"])
    else:
        assert found[2] is first


def test_what_was_calibrated_before_is_still_stated():
    rng = np.random.default_rng(0)
    base = mm.Survey(rng.random((20, 3)), rng.normal(-40e-6, 1e-6, (20, 3)))
    target = replace(base, field=base.field + OFFSET)
    calibrated = {"target": {"time_offset": 0.0, "matrix": np.eye(3).tolist(), "shift": [4e-6, 0.0, 0.0]}}
    first = replace(REFUSED, sensor={"bias": [9e-6, 0.0, 0.0], "scale": 1.5, "calibrated": calibrated})
    *_, answer = with_vertical_offset((base, target, first), lambda base, target, *_: (base, target, FOUND))
    assert answer.sensor == {"bias": pytest.approx(OFFSET + FOUND.sensor["bias"]), "calibrated": calibrated}


def test_an_offset_is_the_less_likely_the_larger_it_is():
    """Beside an offset that was chosen lie those that the refinement allows, of all that two sensors may have."""
    allowed = norm(0, BIAS_LEVELS[-1]).pdf(0)
    for offset in (3e-6, 30e-6):
        told = []
        base = mm.Survey(np.eye(3), np.full((3, 3), -4e-5))
        target = replace(base, field=base.field + offset * UP)
        with_vertical_offset((base, target, REFUSED), lambda *given, told=told: told.append(given[-1]))
        assert told == pytest.approx([np.log(norm(0, np.sqrt(2) * HARD_IRON_SD).pdf(offset) / allowed)])


@pytest.mark.parametrize(
    "settings",
    [
        {},
        UPRIGHT.model_dump() | {"calibrate": False},
        {**UPRIGHT.model_dump(), "refinement": {"sensor": {"mode": "none"}}},
    ],
    ids=["any pose", "as given", "like sensors"],
)
def test_it_is_not_looked_for_where_it_cannot_be(settings, monkeypatch):
    def asked(found, look):
        pytest.fail("asked for an offset")

    monkeypatch.setattr("magmatch.registration.register.with_vertical_offset", asked)
    base = mm.simulate("uniform", 1, SimulationConfig(n_samples=40))
    assert not mm.register(base.base, base.target, mm.RegistrationConfig(**settings)).is_accepted
