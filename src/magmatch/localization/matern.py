# SPDX-License-Identifier: BSD-3-Clause
"""A Matern-3/2 process along a path as a filter has it: its value, and its slope over its rate, of one variance."""

import numpy as np

from magmatch.compiled import inlined


@inlined
def transition(v):  # type: ignore[no-untyped-def]
    """Give how value and slope depend on both a path of rate times length v before: f00, f01, f10, f11."""
    e = np.exp(-v)
    return e * (1 + v), e * v, -e * v, e * (1 - v)


@inlined
def transition_of(is_smooth, x):  # type: ignore[no-untyped-def]
    """Give the transition over so many lengthscales; a rough one is Ornstein-Uhlenbeck, without slope."""
    if is_smooth:
        return transition(np.sqrt(3.0) * x)
    return np.exp(-x), 0.0, 0.0, 0.0
