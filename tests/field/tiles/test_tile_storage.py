# SPDX-License-Identifier: BSD-3-Clause
"""Maps in tiles on disk: loading fits nothing, adding a survey touches only its tiles, damage is named."""

import numpy as np
import pytest

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior
from magmatch.field.map import FieldMap
from magmatch.field.saved_map import MapRecord
from magmatch.field.tiles.tiled_posterior import TiledPosterior

CONFIG = FieldConfig(prior="spline", lengthscale=0.5, signal_sd=5e-6, noise_sd=3e-7, spacing=0.15)


@pytest.fixture(autouse=True)
def _tiles_at_once(monkeypatch):
    """Maps of these tests are small; tile them all the same."""
    monkeypatch.setattr("magmatch.field.tiles.region_model.MOST_CELLS", 0)


def walk(low, high, seed=0, name="walk", y=0.0):
    """Samples along a corridor."""
    rng = np.random.default_rng(seed)
    x = np.arange(low, high, 0.06)
    p = np.stack([x, y + 0.1 * np.sin(x), 1 + 0.02 * rng.normal(size=len(x))], axis=1)
    b = 4e-5 + 5e-6 * np.stack([np.sin(p[:, 0]), np.cos(p[:, 1]), np.sin(p[:, 2] + p[:, 0])], axis=1)
    return Survey(p, b + rng.normal(0, 1e-7, p.shape), times=np.arange(len(x)) / 10, name=name, frame="hall")


@pytest.fixture(scope="module")
def old():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("magmatch.field.tiles.region_model.MOST_CELLS", 0)
        return build_map(walk(0, 14), CONFIG)


@pytest.fixture
def saved(old, tmp_path):
    old.save(tmp_path / "hall.map")
    return tmp_path / "hall.map"


def refuse(*_):
    """Stand in for fitting where nothing should be fitted."""
    raise AssertionError


def tiles(path):
    """Bytes of every tile of a saved map by its index."""
    return {index: tile.weights.tobytes() for index, tile in MapRecord.read(path).tiles.items()}


def test_loading_fits_nothing_and_says_the_same_to_the_bit(saved, old, monkeypatch):
    assert isinstance(old.posterior, TiledPosterior)
    assert len(old.posterior.tiles) > 3
    points = old.survey.positions[::7]
    with monkeypatch.context() as patch:
        patch.setattr("magmatch.field.spline.spline_model.factorise", refuse)
        loaded = FieldMap.load(saved)
        assert np.array_equal(loaded.evaluate(points, 2).second, old.evaluate(points, 2).second)
        assert loaded.knows(points).all()
    assert np.array_equal(loaded.covariance(points), old.covariance(points))
    draws = [m.draw(points[:5], 2, 1, np.random.default_rng(2))[1].gradient for m in (old, loaded)]
    assert np.array_equal(*draws)


def test_adding_a_survey_fits_only_the_tiles_it_touches(saved, tmp_path, monkeypatch):
    before, fitted = FieldMap.load(saved), []

    def run(fit, tasks):
        for task in tasks:
            fitted.append(task.arguments[0].index)
            yield fit(task)

    added = before.with_surveys(walk(13, 15, seed=1, name="later"), run=run)
    added.save(tmp_path / "new.map")
    old_tiles, new_tiles = tiles(saved), tiles(tmp_path / "new.map")
    assert 0 < len(fitted) < len(added.posterior.tiles)
    assert {index for index, w in new_tiles.items() if w != old_tiles.get(index)} == set(fitted)
    was, now = (MapRecord.read(path).surveys[0] for path in (saved, tmp_path / "new.map"))
    assert all(np.array_equal(getattr(was, name), getattr(now, name)) for name in ("positions", "field", "times"))
    assert np.array_equal(added.T_map_model.as_matrix(), before.T_map_model.as_matrix())
    assert added.hyperparameters == before.hyperparameters


def test_leaving_samples_out_fits_only_the_tiles_that_saw_them(old):
    fitted = []

    def run(fit, tasks):
        for task in tasks:
            fitted.append(task.name)
            yield fit(task)

    is_out = np.zeros(len(old.survey), dtype=bool)
    is_out[[2, 3]] = True
    without = old.without_samples(is_out, run)
    assert 0 < len(fitted) < len(without.posterior.tiles)
    rebuilt = fit_posterior(old.fitted_samples.subset(~is_out), old.hyperparameters, old.config, old.T_domain_model)
    assert np.array_equal(without.posterior.weights, rebuilt.weights)
    assert np.array_equal(without.survey.positions, old.survey.positions[~is_out])


def test_adding_equals_building_anew_with_the_same_numbers(saved, tmp_path):
    added = FieldMap.load(saved).with_surveys(walk(13, 15, seed=1), walk(3, 5, seed=2, y=0.5))
    rebuilt = fit_posterior(added.fitted_samples, added.hyperparameters, added.config, added.T_domain_model)
    assert added.posterior.tiles == rebuilt.tiles
    assert np.array_equal(added.posterior.weights, rebuilt.weights)
    added.save(tmp_path / "m")
    assert np.array_equal(FieldMap.load(tmp_path / "m").posterior.weights, rebuilt.weights)
