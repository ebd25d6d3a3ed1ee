# SPDX-License-Identifier: BSD-3-Clause
"""Tests cannot compare with a tolerance that passes anything."""

import numpy as np
import pytest


def test_variances_in_tesla_squared_are_not_equal_by_default():
    assert pytest.approx(4e-13) != 1e-13
    assert pytest.approx(4e-13, rel=0.1) == 4.1e-13


@pytest.mark.parametrize("expected", [4e-13, [0.0, 4e-13]])
def test_a_tolerance_as_large_as_the_value_fails(expected):
    with pytest.raises(pytest.fail.Exception, match="zero would pass"):
        np.testing.assert_allclose(expected, expected, atol=1e-12)
    with pytest.raises(pytest.fail.Exception, match="zero would pass"):
        pytest.approx(expected, abs=1e-12)


def test_zero_may_be_compared_with_any_tolerance():
    np.testing.assert_allclose(1e-13, 0.0, atol=1e-12)
    assert pytest.approx(0.0, abs=1e-12) == 1e-13
