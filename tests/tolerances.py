# SPDX-License-Identifier: BSD-3-Clause
"""Comparisons that zero would pass as well are refused: their tolerance says nothing about the value.

Fields are of the order of 1e-5 T and their variances of 1e-12 T^2, so a tolerance that suits lengths passes anything.
Hence `pytest.approx` has no absolute tolerance unless one is given, and one that is given is compared with what is
expected. Any will do where zero is expected, or Hypothesis draws the example, since it tries the tiniest numbers.
"""

from functools import wraps

import numpy as np
import pytest
from hypothesis import currently_in_test_context


def refuse_hollow(expected, atol, rtol):
    """Fail where tolerances are as large as all that is expected."""
    try:
        sizes = np.abs(np.asarray(expected, dtype=float))
    except (TypeError, ValueError):
        return  # no plain numbers
    size, tolerance = np.max(sizes[np.isfinite(sizes)], initial=0.0), np.max(atol)
    if 0 < size <= tolerance + rtol * size and not currently_in_test_context():
        pytest.fail(f"zero would pass: the tolerance is {tolerance:.3g}, what is expected at most {size:.3g}")


def guard():
    """Let all tests compare so."""
    plain_close, plain_approx = np.testing.assert_allclose, pytest.approx

    @wraps(plain_close)
    def assert_allclose(actual, desired, rtol=1e-7, atol=0, **how):
        refuse_hollow(desired, atol, rtol)
        return plain_close(actual, desired, rtol=rtol, atol=atol, **how)

    @wraps(plain_approx)
    def approx(expected, rel=None, abs=None, nan_ok=False):
        if abs is None:
            return plain_approx(expected, 1e-6 if rel is None else rel, 0.0, nan_ok)
        refuse_hollow(expected, abs, rel or 0.0)
        return plain_approx(expected, rel, abs, nan_ok)

    np.testing.assert_allclose, pytest.approx = assert_allclose, approx
