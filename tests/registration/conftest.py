# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of maps whose field is known exactly."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from exact_maps import EARTH, Dipoles, exact_map, room_of_dipoles, survey_in

BOX = np.array([3.0, 3.0, 0.6])


def pair_of(rng, before, after, T_base_target):
    """A map of each, with 0.3 uT of noise; the target's in a frame of its own."""
    for source, T in ((before, RigidTransform.identity()), (after, T_base_target)):
        x = rng.uniform(0, BOX, size=(800, 3))
        yield exact_map(source, survey_in(source, x, T, 0.3e-6 * rng.standard_normal(x.shape)), T)


@pytest.fixture(scope="session")
def make_exact_pair():
    """Build (base map, target map, T_base_target) of one room, or of two different ones."""

    def make(seed, T_base_target, other_room=False):
        source = room_of_dipoles(seed, BOX)
        other = room_of_dipoles(seed + 1000, BOX) if other_room else source
        return tuple(pair_of(np.random.default_rng(seed), source, other, T_base_target))

    return make


@pytest.fixture(scope="session")
def make_moved_pair():
    """Build (base map, target map, what the field changed by) of a room whose strongest dipoles moved in between."""

    def make(seed, T_base_target, n_moved):
        rng = np.random.default_rng(seed)
        before = room_of_dipoles(seed, BOX)
        samples = rng.uniform(0, BOX, size=(300, 3))
        alone = (Dipoles(before.positions[[k]], before.moments[[k]]) for k in range(len(before.positions)))
        pull = [np.abs(one.values(samples, 0).field - EARTH).max() for one in alone]
        positions = before.positions.copy()
        for k in np.argsort(pull)[-n_moved:]:
            outward = positions[k] - np.clip(positions[k], 0, BOX)
            positions[k] += 0.5 * np.cross(outward, [0.3, 0.5, 0.8]) / np.linalg.norm(outward) + 0.1 * outward
        after = Dipoles(positions, before.moments)

        def change(x):
            return after.values(x, 0).field - before.values(x, 0).field

        return *pair_of(rng, before, after, T_base_target), change

    return make
