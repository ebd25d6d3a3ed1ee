# SPDX-License-Identifier: BSD-3-Clause
"""A region in one piece stores its fit, and recalls the fit of the very same samples only."""

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.tiles.region_model import WholeModel, lay_splines, tiles_to_store

H = Hyperparameters(lengthscale=0.5, signal_sd=5e-6, noise_sd=3e-7, spacing=0.3)


def test_a_stored_fit_is_recalled_for_its_own_samples_and_made_again_for_others():
    rng = np.random.default_rng(0)
    x, n_fitted = rng.uniform(0, 1, (200, 3)), []
    b = 5e-6 * np.sin(3 * x) + 3e-7 * rng.normal(size=x.shape)
    model = lay_splines(x, H)
    assert isinstance(model, WholeModel)

    def run(fit, tasks):
        n_fitted.append(len(tasks := list(tasks)))
        return map(fit, tasks)

    first = model.fit(x, b, {}, run)
    stored = tiles_to_store(first, x, b)
    again = model.fit(x, b, stored, run)
    assert n_fitted == []
    assert np.array_equal(again.evaluate(x).field, first.evaluate(x).field)
    other = model.fit(x, 2 * b, stored, run)
    assert n_fitted == [1]
    np.testing.assert_allclose(other.evaluate(x).field, model.fit(x, 2 * b, {}, run).evaluate(x).field, atol=1e-12)
