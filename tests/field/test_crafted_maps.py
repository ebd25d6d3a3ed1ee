# SPDX-License-Identifier: BSD-3-Clause
"""A map made to deceive, with digests that fit, is refused in one line that names the entry."""

from dataclasses import replace

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
from magmatch.field.saved_map import SCHEMA
from magmatch.field.tiles.tile_fit import FitError
from magmatch.store import load, save


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of a small saved map."""
    rng = np.random.default_rng(0)
    p = rng.uniform(0, [2.0, 1.5, 0.5], (60, 3))
    b = 4e-5 + 1e-5 * np.stack([np.sin(p[:, 0]), np.cos(p[:, 1]), np.sin(p[:, 2] + p[:, 0])], axis=1)
    config = FieldConfig(prior="spline", lengthscale=0.8, signal_sd=1e-5, noise_sd=1e-7, spacing=0.5)
    path = tmp_path_factory.mktemp("maps") / "m"
    build_map(Survey(p, b, np.arange(60.0), Rotation.random(60, rng=rng)), config).save(path)
    return path.read_bytes()


@pytest.fixture
def saved(whole, tmp_path):
    (tmp_path / "room.map").write_bytes(whole)
    return tmp_path / "room.map"


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
    "no surveys": (put("surveys", ()), "fitted samples"),
    "words as times": (survey(times="x"), "times"),
    "times empty and endless": (survey(times=np.zeros((0, 2**31))), "times"),
    "positions of four columns": (survey(positions=np.zeros((60, 4))), "shape (60, 4)"),
    "fewer samples in the model": (
        put("fitted_samples", Survey(np.zeros((9, 3)), np.ones((9, 3)))),
        "as many fitted",
    ),
    "position NaN": (number("positions", 0, np.nan), "expected finite positions"),
    "orientations an array": (survey(orientations=np.zeros((60, 4))), "orientations: expected Rotation"),
    "position of the model changed": (number("positions", 4, 0.3, "fitted_samples"), "gives another field"),
    "field of the model changed": (number("field", 4, 3e-5, "fitted_samples"), "gives another field"),
    "a tile of words": (tile(("0", 0, 0)), "entry 'tile 0.0.0': expected the weights of one tile"),
    "a tile that is none": (put("tiles", [((0, 0, 0), 1)]), "expected the weights of one tile"),
    "weights of a tile missing": (tile(weights=None), "no attribute 'dtype'"),
    "weight of a tile NaN": (tile(weights=np.full(3, np.nan)), "entry 'tile 0.0.0': expected finite numbers"),
    "weights of another number": (tile(weights=np.ones(10)), "tile 0.0.0: 10 weights are stored"),
    "fingerprint changed": (tile(fingerprint="x"), "gives another field"),
    "transform a word": (put("T_map_model", "I"), "entry 'T_map_model': expected RigidTransform, found 'I'"),
    "prior unknown": (lambda c: c["config"].update(prior="magic"), "config.prior"),
    "number a word": (numbers(spacing="x"), "expected plain numbers"),
    "noise zero": (numbers(noise_sd=0), "expected positive"),
    "divergence weight negative": (numbers(divergence_weight=-1.0), "divergence weight that is not negative"),
    "reach without end": (numbers(reach=2000), "at most 32"),
    "nodes beyond counting": (numbers(spacing=1e-9), "too large for a spacing"),
    "name a number": (survey(name=1), "name: expected str"),
    "accuracy negative": (survey(pose_sd=-1), "pose_sd"),
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
