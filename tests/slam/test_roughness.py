# SPDX-License-Identifier: BSD-3-Clause
"""The amplitude of a stretch's map follows how rough the field is along it."""

from dataclasses import replace

import numpy as np

import magmatch as mm
from drifting import Place
from magmatch.slam.shared_hyperparameters import as_rough_as_here, shared_hyperparameters, squared_gradient


def test_a_stretch_as_rough_as_all_paths_has_their_numbers_and_a_tenth_of_it_a_tenth():
    path = np.linspace([-4.0, 0, 0], [4.0, 0, 0], 800)
    stretch = mm.Survey(path, Place(0).field(path))
    numbers, length, _ = shared_hyperparameters([stretch])
    everywhere = squared_gradient([stretch], length)
    assert as_rough_as_here(numbers, everywhere, stretch, length) == numbers
    weaker = replace(stretch, field=stretch.field / 10)
    of_weaker = as_rough_as_here(numbers, everywhere, weaker, length)
    assert np.isclose(of_weaker.prior_scale / numbers.prior_scale, 1 / 10)


def test_a_stretch_without_any_change_keeps_the_numbers():
    path = np.linspace([-4.0, 0, 0], [4.0, 0, 0], 800)
    walk = mm.Survey(path, Place(0).field(path))
    numbers, length, everywhere = shared_hyperparameters([walk])
    still = replace(walk, field=np.tile(walk.field[:1], (800, 1)))
    assert as_rough_as_here(numbers, everywhere, still, length) == numbers
