# SPDX-License-Identifier: BSD-3-Clause
"""The climb in the evidence: where it ends, and how many factorisations it takes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.field.evidence_climb import climb, settle
from magmatch.field.hyperparameters import Hyperparameters

START = Hyperparameters(0.5, 3e-6, 0.1e-6, 0.2, stiffness=300.0)


class Hill:
    """Stands in for a search: evidence that falls with the square of the logarithms' distance from a top."""

    def __init__(self, top):
        self.top, self.asked = top, set()

    def log_evidence(self, h):
        self.asked.add(h)
        names = ("noise_sd", "stiffness", "lengthscale")
        return -100 * sum(np.log(getattr(h, name) / getattr(self.top, name)) ** 2 for name in names)

    log_evidence_of_noise = log_evidence

    def noise_sd(self, h):
        return 0.3e-6 * (h.noise_sd / START.noise_sd) ** 0.1


@given(noise=st.floats(-4, 3), stiffness=st.floats(-2, 1), lengthscale=st.floats(-0.2, 1.4))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_the_top_of_a_hill_is_found_to_a_step_and_its_noise_nearly(noise, stiffness, lengthscale):
    top = replace(
        START,
        noise_sd=START.noise_sd * np.exp(noise),
        stiffness=START.stiffness * 10**stiffness,
        lengthscale=START.lengthscale * np.exp(lengthscale),
    )
    hill = Hill(top)
    best = climb(hill, START)
    # A step that gains less than two nats is not taken.
    assert abs(np.log10(best.stiffness / top.stiffness)) < 0.51
    assert abs(np.log(best.lengthscale / top.lengthscale)) < 0.34
    assert best.noise_sd == pytest.approx(top.noise_sd, rel=0.02)
    assert len(hill.asked) <= 21


def test_noise_settles_within_five_fits_near_its_top_and_its_level_is_that_there():
    hill = Hill(replace(START, noise_sd=1.5 * START.noise_sd))
    best, level = settle(hill, START, lambda _: None, is_settled=False)
    assert best.noise_sd == pytest.approx(1.5 * START.noise_sd)
    assert level == pytest.approx(hill.noise_sd(best))
    assert len(hill.asked) <= 5


def test_a_noise_that_was_found_already_is_kept():
    hill = Hill(replace(START, noise_sd=1.5 * START.noise_sd))
    assert settle(hill, START, lambda _: None, is_settled=True) == (START, hill.noise_sd(START))


def test_finer_splines_are_taken_while_the_evidence_grows():
    class Finer(Hill):
        def log_evidence(self, h):
            return super().log_evidence(h) - 50 * np.log(h.spacing / 0.1) ** 2

        log_evidence_of_noise = log_evidence

    for is_settled in (True, False):
        best, _ = settle(Finer(START), START, lambda h: replace(h, spacing=h.spacing / 1.4), is_settled)
        assert best.spacing == pytest.approx(0.2 / 1.4**2)
        assert best.noise_sd == pytest.approx(START.noise_sd)
