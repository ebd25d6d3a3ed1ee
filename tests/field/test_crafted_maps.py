# SPDX-License-Identifier: BSD-3-Clause
"""A map made to deceive, with digests that fit, is refused in one line that names the entry."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.field.saved_map import SCHEMA, MapRecord
from magmatch.field.tiles.tile_fit import FitError
from magmatch.store import load, save


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of a small saved map."""
    rng = np.random.default_rng(0)
    p = rng.uniform(0, [2.0, 1.5, 0.5], (60, 3))
    b = 4e-5 + 1e-5 * np.stack([np.sin(p[:, 0]), np.cos(p[:, 1]), np.sin(p[:, 2] + p[:, 0])], axis=1)
    config = FieldConfig(lengthscale=0.8, signal_sd=1e-5, noise_sd=1e-7, spacing=0.5)
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


def repack(path, change, schema=SCHEMA):
    """Change the content of a map and write it again, as an attacker would."""
    content = load(path, SCHEMA)
    change(content)
    save(path, schema, content)
    return path


def put(*keys_and_value):
    """Change one value of the content."""
    *keys, last, value = keys_and_value

    def change(content):
        for key in keys:
            content = content[key]
        content[last] = value

    return change


def drop(*keys):
    *keys, last = keys

    def change(content):
        for key in keys:
            content = content[key]
        del content[last]

    return change


def number(name, at, value):
    """Change one number of an array of the only survey."""
    return lambda content: content["surveys"][0][name].reshape(-1).__setitem__(at, value)


CRAFTED = {
    "an entry missing": (drop("surveys"), "entry 'surveys' is missing"),
    "an array missing": (drop("surveys", 0, "field"), "entry 'field' is missing"),
    "surveys a number": (put("surveys", 1), "entry 'surveys': expected a list"),
    "no surveys": (put("surveys", []), "entry 'surveys': expected a list"),
    "a survey a number": (put("surveys", 0, 1), "not subscriptable"),
    "an array of whole numbers": (put("surveys", 0, "times", np.arange(60)), "'surveys.0.times': expected an array"),
    "times empty and endless": (
        put("surveys", 0, "times", np.zeros((0, 2**31))),
        "entry 'surveys.0.times': expected an array of shape (n,), found (0, 2147483648)",
    ),
    "positions of four columns": (put("surveys", 0, "positions", np.zeros((60, 4))), "shape (n, 3), found (60, 4)"),
    "positions flat": (put("surveys", 0, "positions", np.zeros(60)), "'surveys.0.positions': expected an array"),
    "positions a list": (put("surveys", 0, "positions", [[0.0] * 3] * 60), "shape (n, 3), found list"),
    "fewer samples in the model": (put("surveys", 0, "model_positions", np.zeros((9, 3))), "as many samples as in"),
    "position NaN": (number("positions", 0, np.nan), "expected finite positions"),
    "field infinite": (number("field", 5, np.inf), "expected finite field"),
    "orientation not unit": (number("orientations", 0, 3.0), "expected unit quaternions"),
    "position of the model changed": (number("model_positions", 4, 0.3), "gives another field"),
    "field of the model changed": (number("model_field", 4, 3e-5), "gives another field"),
    "no tile": (put("tiles", []), "entry 'weights': expected an array"),
    "a tile of words": (put("tiles", 0, 0, "0"), "entry 'tiles': expected the three indices"),
    "a tile cut short": (put("tiles", 0, [0, 0, 0]), "not enough values to unpack"),
    "weights of a tile missing": (put("tiles", 0, 4, None), "entry 'tile 0.0.0': expected an array"),
    "weight of a tile NaN": (put("tiles", 0, 4, np.full(3, np.nan)), "expected finite tile 0.0.0"),
    "fingerprint changed": (put("tiles", 0, 3, "x"), "gives another field"),
    "fingerprint a number": (put("tiles", 0, 3, 1), "the fingerprint"),
    "transform a word": (put("T_map_model", "I"), "entry 'T_map_model': expected a rigid transform, found 'I'"),
    "prior unknown": (put("config", "prior", "magic"), "config.prior"),
    "setting unknown": (put("config", "colour", 1), "config.colour"),
    "number missing": (put("hyperparameters", {}), "hyperparameters': expected"),
    "number unknown": (put("hyperparameters", "colour", 1), "expected numbers"),
    "number a word": (put("hyperparameters", "spacing", "x"), "expected numbers"),
    "noise zero": (put("hyperparameters", "noise_sd", 0), "expected positive"),
    "noise NaN": (put("hyperparameters", "noise_sd", np.nan), "expected positive"),
    "divergence weight negative": (put("hyperparameters", "stiffness", -1), "divergence weight that is not negative"),
    "reach without end": (put("hyperparameters", "reach", 2000), "at most 32"),
    "nodes beyond counting": (put("hyperparameters", "spacing", 1e-9), "too large for a spacing"),
    "name a number": (put("surveys", 0, "name", 1), "expected frame and name"),
    "accuracy negative": (put("surveys", 0, "pose_sd", -1), "frame and name in"),
}


@pytest.mark.parametrize("case", CRAFTED)
def test_crafted_map_with_fitting_digests_is_refused(saved, case):
    change, message = CRAFTED[case]
    assert message in refusal(repack(saved, change))


def test_weights_that_are_not_the_samples_own_are_refused_once_they_are_used_for_a_covariance(saved):
    field_map = FieldMap.load(repack(saved, lambda c: c["tiles"][0][4].fill(1e-5)))
    with pytest.raises(FitError, match=r"tile 0\.0\.0: fitting its samples again gives another field"):
        field_map.covariance(field_map.survey.positions)


def test_weights_of_another_number_are_refused(saved):
    assert "tile 0.0.0: 10 weights are stored" in refusal(repack(saved, put("tiles", 0, 4, np.ones(10))))


def test_number_that_older_maps_lack_takes_its_default(saved):
    assert (
        MapRecord.read(repack(saved, drop("hyperparameters", "stiffness"))).hyperparameters.divergence_weight == 0.0
    )


def test_map_of_a_later_version_is_refused_with_advice(saved):
    message = refusal(repack(saved, lambda _: None, "magmatch.map/4"))
    assert "expected schema 'magmatch.map/3', found 'magmatch.map/4'" in message
    assert "update" in message
