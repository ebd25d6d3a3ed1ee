# SPDX-License-Identifier: BSD-3-Clause
"""Poses that put a target inside a base are counted as plain counting counts them."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.estimation.pose_prior import PosePrior
from magmatch.registration.prepared.inside import spread_inside
from magmatch.registration.prepared.raster import Raster

SPACING = 0.1
UP = np.array([0.0, 0.0, 1.0])
STEEP = 6.0


def slab(*size):
    """A base that knows a box about the origin, m."""
    shape = tuple(round(s / SPACING) + 1 for s in size)
    n = int(np.prod(shape))
    return Raster.knowing(-np.array(size) / 2, SPACING, shape, np.arange(n), np.zeros((n, 3)), np.ones(n))


def rod(length):
    """Points along a line."""
    return np.linspace(-0.5, 0.5, 40)[:, None] * np.array([length, 0.0, 0.0])


def weight(share):
    return STEEP * (share - 1)


def counted(size, points, turns, rng, height=None):
    """Mean weight of poses whose middle lies anywhere in the box or near it, as a share of the box's volume."""
    n, reach = len(turns), np.linalg.norm(points, axis=1).max()
    wide = np.array(size) + 2 * reach
    at = rng.uniform(-0.5, 0.5, (n, 3)) * wide
    part = np.prod(wide) / np.prod(size)
    if height is not None:
        at[:, 2], part = height, np.prod(wide[:2]) / np.prod(size[:2])
    placed = at[:, None] + np.einsum("hij,nj->hni", turns, points)
    share = (np.abs(placed) <= np.array(size) / 2).all(axis=2).mean(axis=1)
    return np.log(part * np.where(share > 0, np.exp(weight(share)), 0.0).mean())


@pytest.mark.parametrize(("size", "length"), [((4.0, 4.0, 4.0), 2.5), ((8.0, 1.0, 0.6), 2.0)])
def test_any_turn_is_counted_as_by_trying(size, length):
    rng = np.random.default_rng(1)
    found = spread_inside(PosePrior(1.0), slab(*size), rod(length), weight)
    expected = counted(size, rod(length), Rotation.random(100_000, random_state=rng).as_matrix(), rng)
    # Points of the base stand for half a spacing around them: the box seems larger by that.
    assert found.log_share_inside == pytest.approx(expected, abs=0.35)
    assert found.log_density(RigidTransform.identity(), np.zeros(3)) == pytest.approx(
        PosePrior(1.0).log_density(RigidTransform.identity(), np.zeros(3)) - found.log_share_inside
    )


def test_a_line_inside_a_corridor_is_rare_and_less_so_where_the_vertical_is_known():
    corridor, line = slab(12.0, 1.5, 0.6), rod(5.0)
    anywhere = spread_inside(PosePrior(1.0), corridor, line, weight).log_share_inside
    upright = spread_inside(PosePrior(1.0, up_base=UP, up_target=UP), corridor, line, weight).log_share_inside
    assert anywhere < upright - 0.5
    assert upright < -1


def test_headings_at_one_height_are_counted_as_by_trying():
    size, line, rng = (6.0, 3.0, 0.8), rod(2.0), np.random.default_rng(2)
    prior = PosePrior(1.0, up_base=UP, up_target=UP, gravity_sd=1e-4, height=0.0, height_sd=1e-3)
    found = spread_inside(prior, slab(*size), line, weight).log_share_inside
    turns = Rotation.from_rotvec(rng.uniform(0, 2 * np.pi, (100_000, 1)) * UP).as_matrix()
    assert found == pytest.approx(counted(size, line, turns, rng, height=0.0), abs=0.35)


def test_a_rough_pose_says_where_the_target_lies_already():
    prior = PosePrior(1.0, RigidTransform.identity(), np.eye(6))
    assert spread_inside(prior, slab(1.0, 1.0, 1.0), rod(1.0), weight) is prior
