# SPDX-License-Identifier: BSD-3-Clause
"""What a hypothesis expects to read is what the noise of its map says: no rougher, and never worse than no map."""

from dataclasses import replace

import numpy as np
import pytest

import magmatch as mm
from magmatch.localization.bins import STEP
from magmatch.localization.known_map import Ground
from magmatch.localization.measurement import FIT, follow
from magmatch.localization.state import GAIN, MISFIT, SCALE, hypotheses, model_of

SIGMA = 4e-6  # T: said of the map's field


def straight(n, spacing):
    """Bins of a body that walks along x and keeps its axes."""
    steps = np.zeros(n, STEP)
    steps["dR"], steps["R"], steps["M"] = np.eye(3), np.eye(3), np.eye(3)
    steps["u"][1:, 0] = spacing
    return steps


@pytest.fixture
def uniform(known):
    """A map of the same noise whose field is the same everywhere, and as uncertain."""
    values = np.zeros((3, 3, 3, 4))
    values[..., :3], values[..., 3] = [2e-5, 0, -4e-5], SIGMA
    return replace(known, ground=Ground(values, np.full(3, -50.0), 50.0, known.up))


@pytest.mark.parametrize("is_smooth", [False, True])
def test_a_path_is_as_likely_as_under_the_noise_that_was_learned(uniform, is_smooth):
    uniform = replace(uniform, noise=replace(uniform.noise, is_smooth=is_smooth))
    rng, n, spacing = np.random.default_rng(0), 24, 0.25 * uniform.length
    model = model_of(uniform, mm.LocalizerConfig())._replace(place_walk=0.0, bent_walk=0.0, bias_drift=0.0)
    model = model._replace(turn_walk=0.0, tilt_walk=0.0, gate=np.inf)
    steps, noise = straight(n, spacing), uniform.noise
    d = spacing * np.abs(np.arange(n)[:, None] - np.arange(n))
    x = np.sqrt(3) * d / noise.misfit_length
    C = (1 + x) * np.exp(-x) if is_smooth else np.exp(-d / noise.misfit_length)
    C *= noise.misfit_sd**2 + noise.constant_sd**2
    x = model.error_rate * d
    C += (noise.map_factor * SIGMA) ** 2 * (1 + x) * np.exp(-x) + noise.nugget_sd**2 * np.eye(n)
    # As smooth as the squared exponential that was learned, where it has fallen to a half.
    half = noise.map_length * np.sqrt(2 * np.log(2))
    assert (1 + model.error_rate * half) * np.exp(-model.error_rate * half) == pytest.approx(0.5, abs=1e-3)
    L = np.linalg.cholesky(C)
    residual = L @ rng.standard_normal((n, 3))
    steps["z"] = uniform.ground.values[0, 0, 0, :3] + residual
    # Nothing but the noise is unknown.
    one, fit = hypotheses(1), np.zeros((n, 1), FIT)
    one["P"] = 0.0
    one["P"][0, MISFIT:SCALE, MISFIT:SCALE] = np.eye(SCALE - MISFIT)
    one["P"][0, GAIN, GAIN] = 0.0
    follow(one, uniform, model, steps, fit, moves_first=False)
    dense = 0.5 * (np.linalg.solve(L, residual) ** 2).sum() + 3 * np.log(np.diag(L)).sum()
    assert (0.5 * fit["chi2"] + fit["half_log_det"]).sum() == pytest.approx(dense, rel=1e-6)


def test_what_a_map_does_not_know_varies_no_more_than_its_field(known):
    sd = known.ground.values[..., 3]
    assert known.noise.map_factor * sd.max() < known.field_sd
