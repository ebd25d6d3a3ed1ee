# SPDX-License-Identifier: BSD-3-Clause
"""A saved map is the map, to the bit; whatever is not one is refused in one line."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import StoredTile
from magmatch.field.map import FieldMap
from magmatch.field.priors import PRIORS
from magmatch.field.saved_map import SCHEMA
from magmatch.field.tiles.tile_fit import FitError
from magmatch.geometry import random_transform
from magmatch.store import load, save


def make_survey(n=60, seed=0, **changes):
    rng = np.random.default_rng(seed)
    p = rng.uniform(0, [2.0, 1.5, 0.5], (n, 3))
    b = 4e-5 + 1e-5 * np.stack([np.sin(p[:, 0]), np.cos(p[:, 1]), np.sin(p[:, 2] + p[:, 0])], axis=1)
    fields = {
        "positions": p,
        "field": b + rng.normal(0, 1e-7, (n, 3)),
        "times": np.arange(float(n)) / 10,
        "orientations": Rotation.random(n, rng=rng),
        "frame": "odom",
        "name": "Flur – 1",
        "pose_sd": 0.01,
    }
    return Survey(**(fields | changes))


@cache
def make_map(prior="spline", **changes):
    config = FieldConfig(prior=prior, lengthscale=0.8, signal_sd=1e-5, noise_sd=1e-7, spacing=0.5)
    return build_map(make_survey(**changes), config)


@pytest.fixture(scope="module", params=sorted(PRIORS))
def field_map(request):
    return make_map(request.param)


@pytest.fixture(scope="module")
def spline_map():
    return make_map()


@pytest.fixture
def saved(spline_map, tmp_path):
    spline_map.save(tmp_path / "room.map")
    return tmp_path / "room.map"


def says(field_map, points):
    """All that a map answers, as one list of arrays."""
    values = field_map.evaluate(points, 2)
    return [values.field, values.gradient, values.second, field_map.covariance(points), field_map.knows(points)]


def points_around(n=200):
    return np.random.default_rng(1).uniform([-2, -2, -1], [4, 3, 2], (n, 3))


@pytest.mark.parametrize("is_carried", [False, True])
def test_loaded_map_says_the_same_to_the_bit_wherever_it_was_carried(field_map, is_carried, tmp_path):
    field_map = field_map.transformed(random_transform(np.random.default_rng(5), 1000.0 * is_carried))
    field_map.save(tmp_path / "m")
    loaded, q = FieldMap.load(tmp_path / "m"), field_map.T_map_model.apply(points_around())
    for before, after in zip(says(field_map, q), says(loaded, q), strict=True):
        assert np.array_equal(before, after)
    assert np.array_equal(loaded.T_map_model.as_matrix(), field_map.T_map_model.as_matrix())
    grid = field_map.grid_over(0.3)
    assert np.array_equal(loaded.on_grid(grid).values.second, field_map.on_grid(grid).values.second)
    draws = [m.draw(points_around(5), 3, 1, np.random.default_rng(2))[2].gradient for m in (field_map, loaded)]
    assert np.array_equal(*draws)


def test_samples_and_settings_come_back_to_the_bit(field_map, tmp_path):
    field_map.save(tmp_path / "m")
    loaded = FieldMap.load(tmp_path / "m")
    before, after = field_map.survey, loaded.survey
    for name in ("positions", "field", "times"):
        assert np.array_equal(getattr(after, name), getattr(before, name))
    assert np.array_equal(after.orientations.as_quat(), before.orientations.as_quat())
    assert (after.frame, after.name, after.pose_sd) == ("odom", "Flur – 1", 0.01)
    assert loaded.config == field_map.config
    assert loaded.hyperparameters == field_map.hyperparameters
    assert np.array_equal(loaded.posterior.weights, field_map.posterior.weights)


def test_same_map_gives_the_same_bytes_at_any_time(field_map, tmp_path, monkeypatch):
    field_map.save(tmp_path / "a")
    monkeypatch.setattr("time.time", lambda: 2e9)
    FieldMap.load(tmp_path / "a").save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_map_with_nan_is_not_written(tmp_path, spline_map):
    broken = replace(spline_map, survey=replace(spline_map.survey, positions=spline_map.survey.positions.copy()))
    broken.survey.positions[3] = np.nan
    with pytest.raises(ValueError, match="'positions': expected finite"):
        broken.save(tmp_path / "m")
    assert not list(tmp_path.iterdir())


# --- Maps made to deceive, with digests that fit ----------------------------------------------------------------


def refusal(path):
    """The message with which a file is refused: one line that names the file."""
    with pytest.raises(DataFormatError) as caught:
        FieldMap.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


KINDS = (Hyperparameters, StoredTile, Survey)


def repack(path, change, schema=SCHEMA):
    """Change the content of a map and write it again, as an attacker would."""
    content = load(path, SCHEMA, KINDS)
    change(content)
    save(path, schema, content)
    return path


def put(name, value):
    return lambda content: content.__setitem__(name, value)


def survey(**changes):
    """Change what the only survey holds, unchecked."""
    return lambda content: [object.__setattr__(content["surveys"][0], *change) for change in changes.items()]


def number(name, at, value, of="surveys"):
    """Change one number of an array of samples."""

    def change(content):
        samples = content[of] if of == "fitted_samples" else content[of][0]
        getattr(samples, name).reshape(-1)[at] = value

    return change


def tile(index=(0, 0, 0), **changes):
    def change(content):
        ((_, one),) = content["tiles"]
        content["tiles"] = [(index, replace(one, **changes))]

    return change


def numbers(**changes):
    """Change hyperparameters; None leaves one out."""
    return lambda c: c.update(hyperparameters=replace(c["hyperparameters"], **changes))


CRAFTED = {
    "an entry missing": (lambda c: c.pop("surveys"), "entry 'surveys' is missing"),
    "an entry too many": (put("colour", 1), "unexpected keyword argument 'colour'"),
    "surveys of numbers": (put("surveys", [1]), "entry 'surveys': expected Survey, found 1"),
    "words as times": (survey(times="x"), "times"),
    "positions of four columns": (survey(positions=np.zeros((60, 4))), "shape (60, 4)"),
    "fewer samples in the model": (
        put("fitted_samples", Survey(np.zeros((9, 3)), np.ones((9, 3)))),
        "as many fitted",
    ),
    "position NaN": (number("positions", 0, np.nan), "expected finite positions"),
    "position of the model changed": (number("positions", 4, 0.3, "fitted_samples"), "gives another field"),
    "a tile of words": (tile(("0", 0, 0)), "entry 'tile 0.0.0': expected the weights of one tile"),
    "weight of a tile NaN": (tile(weights=np.full(3, np.nan)), "entry 'tile 0.0.0': expected finite numbers"),
    "weights of another number": (tile(weights=np.ones(10)), "tile 0.0.0: 10 weights are stored"),
    "fingerprint changed": (tile(fingerprint="x"), "gives another field"),
    "prior unknown": (lambda c: c["config"].update(prior="magic"), "config.prior"),
    "noise zero": (numbers(noise_sd=0), "expected positive"),
    "nodes beyond counting": (numbers(spacing=1e-9), "too large for a spacing"),
}


@pytest.mark.parametrize("case", CRAFTED)
def test_crafted_map_with_fitting_digests_is_refused(saved, case):
    change, message = CRAFTED[case]
    assert message in refusal(repack(saved, change))


def test_weights_that_are_not_the_samples_own_are_refused_once_they_are_used_for_a_covariance(saved):
    field_map = FieldMap.load(repack(saved, lambda c: c["tiles"][0][1].weights.fill(1e-5)))
    with pytest.raises(FitError, match=r"tile 0\.0\.0: fitting its samples again gives another field"):
        field_map.covariance(field_map.survey.positions)


def test_map_of_a_later_version_is_refused_with_advice(saved):
    message = refusal(repack(saved, lambda _: None, "magmatch.map/4"))
    assert "expected schema 'magmatch.map/3', found 'magmatch.map/4'" in message
    assert "update" in message
