"""A folder of three rooms, each mapped in a frame of its own."""

from itertools import pairwise

import numpy as np
import pytest

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.geometry import random_transform
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate

CORNERS = np.array([[-1.2, -1.1, -0.2], [1.1, -0.9, 0.1], [1.2, 1.1, -0.1], [-1.0, 1.2, 0.2], [-1.1, -0.4, 0.1]])
ROOM = SimulationConfig(n_samples=500, room_size=(3.0, 3.0, 0.8))
# Given, so that maps are made at once.
FIELD = FieldConfig(prior="spline", lengthscale=0.7, spacing=0.3, signal_sd=8e-6, noise_sd=0.5e-6)


@pytest.fixture(scope="session")
def rooms(tmp_path_factory):
    """The folder, and per name of a map what was simulated and where its frame lies."""
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    folder, made = tmp_path_factory.mktemp("rooms"), {}
    for seed, name in enumerate(("attic.map", "cellar.map", "hall.map")):
        pair, T_map_base = simulate("office-random", seed, ROOM), random_transform(np.random.default_rng(seed))
        field_map = build_map(pair.base.transformed(T_map_base), FIELD)
        field_map.save(folder / name)
        made[name] = (pair, T_map_base, field_map)
    return folder, made


@pytest.fixture(scope="session")
def walk_in(rooms):
    """Walk through a room, in the frame of its map."""

    def walk(name, rng):
        _, T_map_base, field_map = rooms[1][name]
        legs = [np.linspace(a, b, int(np.linalg.norm(b - a) / 0.03)) for a, b in pairwise(CORNERS)]
        x = T_map_base.apply(np.concatenate(legs))
        return Survey(x, field_map.evaluate(x).field + 0.3e-6 * rng.standard_normal(x.shape))

    return walk
