# SPDX-License-Identifier: BSD-3-Clause
"""The prior over models of one pose: what each pays beforehand, nats, beside a rigid pose in an unchanged field.

All free numbers of a model are integrated out, so a freer model pays for them by its evidence too. What stands here
is for errors that the likelihood does not know: it takes the errors of maps as independent from cell to cell.
"""

from typing import NamedTuple

import numpy as np

from magmatch.typing import Scalars

# Sensors that differ by bias and scale, and once more if by soft iron. Correlated errors of two maps of one place
# look like a bias that gains up to ten nats.
SENSORS_DIFFER = -15.0
# Of a magnetometer's hard iron beforehand, T: a phone or a robot that was not calibrated.
HARD_IRON_SD = 10e-6
# A walk bends at one of these rates, m per square root of a metre, equally likely: of a tracking system, of wheels,
# of cameras, and of a phone's dead reckoning, well done or not.
RATES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)


class Turns(NamedTuple):
    """How a walk's orientations drift beside its positions."""

    name: str
    per_shift: float  # rad for each metre of shift
    carry_positions: bool  # whether they turn all that follows
    rates: tuple[float, ...]  # m/sqrt(m), of the positions


# Dead reckoning turns what follows, by 0.3 deg with 20 cm. Where positions come from elsewhere (surveyed points,
# cameras of a room), they drift by no more than 10 cm, and orientations err by themselves: while a person walks, by a
# degree and more.
TURNS = (
    Turns("as dead reckoning", 0.03, carry_positions=True, rates=RATES),
    Turns("positions apart", 0.3, carry_positions=False, rates=RATES[:4]),
)
EACH_DRIFT = -float(np.log(sum(len(turns.rates) for turns in TURNS)))
# For each correlation length of a walk's path that its pose leaves unexplained: outside the base map, as there are
# many ways out, and wrong poses tend to lie at its border, where a few bins fit; or disturbed.
UNEXPLAINED = -3.0


def path_weight(path: float, share: Scalars | float) -> Scalars:
    """Log prior weight of poses of a walk, by the share of its path (in correlation lengths) inside the base."""
    return np.asarray(UNEXPLAINED * path * (1 - share))


def overlap_weight(share: Scalars | float) -> Scalars:
    """Log prior weight of poses, by the share of the target that each puts inside the base.

    Most of all possible poses barely touch the base, but surveys of the same place usually overlap. The weight is
    the square of the share, proportional to the number of pairs of samples in common.
    """
    return np.asarray(2 * np.log(share))
