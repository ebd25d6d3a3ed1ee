# SPDX-License-Identifier: BSD-3-Clause
"""Where the heading is known, Earth's field speaks for no place: it is the same everywhere."""

from dataclasses import replace

import numpy as np

from drifting import EARTH, Place, drifting_walk
from magmatch.estimation.walk_null_model import UnrelatedWalk
from magmatch.slam.run import slam


def test_a_field_that_is_the_same_everywhere_closes_nothing():
    log, _ = drifting_walk(Place(1), 1)
    rng = np.random.default_rng(0)
    flat = replace(log, field=EARTH + 3e-7 * rng.standard_normal(log.field.shape))
    assert not slam(flat).graph.closures


def test_an_unrelated_place_shows_earths_field_as_well(lone):
    window = lone.session.paths[0].windows[1]
    noise = lone.session._now.maker.noise
    distance = np.linalg.norm(window.walk.positions[:, None] - window.walk.positions[None], axis=2)
    every = np.ones(len(window.walk), dtype=bool)
    args = window.walk, distance, noise, window.length
    knowing, unknowing = (UnrelatedWalk(*args, around).log_likelihood(every) for around in (window.around, None))
    assert knowing > unknowing + 2
