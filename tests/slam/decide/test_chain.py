# SPDX-License-Identifier: BSD-3-Clause
"""Windows along a log: what forward and backward sums give is what enumerating every course gives."""

from itertools import pairwise, product
from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from magmatch.slam.decide import smooth

REVISIT, KEEPS_ON = 0.4, 0.8


def placed(log_odds, log_prior):
    return SimpleNamespace(log_odds=log_odds, log_prior=log_prior)


@st.composite
def chains(draw):
    sizes = draw(st.lists(st.integers(0, 2), min_size=1, max_size=4))
    number = st.floats(-8, 8)
    windows = [[placed(draw(number), draw(st.floats(-6, 0))) for _ in range(n)] for n in sizes]
    steps = [np.array([draw(number) for _ in range(a * b)]).reshape(a, b) for a, b in pairwise(sizes)]
    return windows, steps, [draw(st.sampled_from([REVISIT, 0.99])) for _ in sizes]


def enumerated(windows, steps, revisits):
    """Probabilities from the weight of every course of states; state 0 is nowhere."""
    found, total = [np.zeros(len(w)) for w in windows], 0.0
    for course in product(*(range(len(w) + 1) for w in windows)):
        density = [0.0 if s == 0 else np.exp(w[s - 1].log_prior) for w, s in zip(windows, course, strict=True)]
        weight = (1 - revisits[0]) if course[0] == 0 else revisits[0] * density[0]
        for k, (s, t) in enumerate(pairwise(course)):
            rho, leaves = revisits[k + 1], 1 - KEEPS_ON
            enters = min(leaves * rho / (1 - rho), rho)
            if s == 0:
                weight *= 1 - enters if t == 0 else enters * density[k + 1]
            elif t == 0:
                weight *= leaves
            else:
                weight *= KEEPS_ON * np.exp(steps[k][s - 1, t - 1]) + leaves * rho * density[k + 1]
        for w, s in zip(windows, course, strict=True):
            weight *= 1.0 if s == 0 else np.exp(w[s - 1].log_odds - w[s - 1].log_prior)
        total += weight
        for k, s in enumerate(course):
            if s:
                found[k][s - 1] += weight
    return [f / total for f in found]


@given(chains())
def test_the_sums_are_those_of_all_courses(chain):
    for ours, theirs in zip(smooth(*chain, KEEPS_ON), enumerated(*chain), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


def test_without_windows_nothing_is_found():
    assert smooth([], [], [], KEEPS_ON) == []
