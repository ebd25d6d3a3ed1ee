# SPDX-License-Identifier: BSD-3-Clause
"""Factors are made once each, and one in double precision serves for everything."""

import numpy as np
import pytest

from magmatch.field.cholesky.multifrontal import Factors


class Factor:
    n_bytes = 8

    def __init__(self, precision):
        self.precision = np.dtype(precision)


@pytest.mark.parametrize(("can_be_light", "n_made"), [(True, 2), (False, 1)])
def test_each_is_made_when_it_is_asked_for_and_then_kept(can_be_light, n_made):
    made = []

    def make(precision):
        made.append(precision)
        return Factor(precision if can_be_light else np.float64)

    factors = Factors(make)
    assert factors.n_bytes == 0
    assert factors.light is factors.light
    assert factors.full.precision == np.float64
    assert len(made) == n_made
    assert factors.n_bytes == 8 * n_made
