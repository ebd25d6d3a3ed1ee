# SPDX-License-Identifier: BSD-3-Clause
"""The climb in the evidence: where it ends, and how many factorisations it takes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.evidence_climb import climb, is_allowed, settle
from magmatch.field.selection.spline_evidence import NoiseSlopes

START = Hyperparameters(0.5, 3e-6, 0.1e-6, 0.2, divergence_weight=300.0)


class Hill:
    """Stands in for a search: evidence that falls with the square of the logarithms' distance from a top."""

    n_independent = 900.0

    def __init__(self, top):
        self.top, self.asked = top, set()

    def log_evidence(self, h):
        self.asked.add(h)
        names = ("noise_sd", "divergence_weight", "lengthscale")
        return -100 * sum(np.log(getattr(h, name) / getattr(self.top, name)) ** 2 for name in names)

    log_evidence_of_noise = log_evidence

    def noise_sd(self, h):
        return 0.3e-6 * (h.noise_sd / START.noise_sd) ** 0.1

    def noise_slopes(self, h):
        assert h in self.asked
        return NoiseSlopes((-200 * np.log(h.noise_sd / self.top.noise_sd), -200.0), (0.1, 0.0))


class Cliff(Hill):
    """The same with a slope that says little of how far it is: less bent the farther up the noise."""

    def log_evidence(self, h):
        self.asked.add(h)
        x = np.log(h.noise_sd / self.top.noise_sd)
        return -100 * np.logaddexp(x, -x)

    log_evidence_of_noise = log_evidence

    def noise_slopes(self, h):
        x = np.log(h.noise_sd / self.top.noise_sd)
        return NoiseSlopes((-100 * np.tanh(x), -100 / np.cosh(x) ** 2), (0.1, 0.0))


@given(noise=st.floats(-4, 3), divergence_weight=st.floats(-2, 1), lengthscale=st.floats(-0.2, 1.4))
@settings(max_examples=50, deadline=None)
def test_the_top_of_a_hill_is_found_to_a_step_and_its_noise_nearly(noise, divergence_weight, lengthscale):
    top = replace(
        START,
        noise_sd=START.noise_sd * np.exp(noise),
        divergence_weight=START.divergence_weight * 10**divergence_weight,
        lengthscale=START.lengthscale * np.exp(lengthscale),
    )
    hill = Hill(top)
    best = climb(hill, START).hyperparameters
    # A step that gains less than two nats is not taken.
    assert abs(np.log10(best.divergence_weight / top.divergence_weight)) < 0.51
    assert abs(np.log(best.lengthscale / top.lengthscale)) < 0.34
    assert best.noise_sd == pytest.approx(top.noise_sd, rel=1e-6)
    assert len(hill.asked) <= 12


@pytest.mark.parametrize("away", [-4.0, -1.0, 1.0, 4.0])
def test_noise_is_found_where_its_slope_says_little_of_how_far_it_is(away):
    cliff = Cliff(replace(START, noise_sd=np.exp(away) * START.noise_sd))
    assert settle(cliff, START, lambda _: None).hyperparameters.noise_sd == pytest.approx(
        cliff.top.noise_sd, rel=0.05
    )
    assert len(cliff.asked) <= 6


def test_finer_splines_have_to_gain_in_proportion_to_the_data():
    class Finer(Hill):
        def log_evidence(self, h):
            return super().log_evidence(h) - 10 * np.log(h.spacing / START.spacing)

        log_evidence_of_noise = log_evidence

    few, many = Finer(START), Finer(START)
    few.n_independent, many.n_independent = 100.0, 10_000.0
    spacings = [settle(hill, START, _half_once).hyperparameters.spacing for hill in (few, many)]
    assert spacings == [START.spacing / 2, START.spacing]


def _half_once(h):
    return replace(h, spacing=h.spacing / 2) if h.spacing == START.spacing else None


def test_a_step_into_numbers_that_cannot_be_used_leads_back():
    class Edge(Hill):
        """Less noise than a third of the start's cannot be used, and the slope leads there."""

        def log_evidence(self, h):
            value = super().log_evidence(h)
            return value if h.noise_sd > START.noise_sd / 3 else -np.inf

        log_evidence_of_noise = log_evidence

    top = climb(Edge(replace(START, noise_sd=START.noise_sd / 20)), START)
    assert np.isfinite(Edge(START).log_evidence(top.hyperparameters))


@given(signal=st.floats(1e-9, 1e-3), slope=st.sampled_from([-1e9, 1e9]))
@settings(max_examples=200, deadline=None)
def test_the_farthest_noise_is_within_bounds(signal, slope):
    class Slide(Hill):
        def noise_slopes(self, h):
            return NoiseSlopes((slope, 0.0), (0.0, 0.0))

        def log_evidence(self, h):
            return slope * np.log(h.noise_sd)

        log_evidence_of_noise = log_evidence

    start = replace(START, signal_sd=signal, noise_sd=signal / 30)
    assert is_allowed(settle(Slide(start), start, lambda _: None).hyperparameters)
