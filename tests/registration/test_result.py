# SPDX-License-Identifier: BSD-3-Clause
"""What a registration found is read back to the last digit, and nothing else is."""

import json
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from magmatch.data.fingerprint import describe_input, hash_survey
from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError
from magmatch.geometry import random_transform, transform_from_matrix
from magmatch.registration.result import Alternative, DegenerateDirection, Links, RegistrationResult, Status

few = settings(deadline=None, max_examples=25)

KEYS = [
    "schema", "status", "reason", "base", "T_base_target", "covariance", "probability", "evidence", "overlap",
    "alternatives", "degenerate_directions", "sensor", "residual", "fitness", "inliers", "keypoints",
    "correspondences", "links", "seconds", "config", "version", "seed", "inputs",
]  # fmt: skip


def accepted(seed=0, **changes):
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(6, 6)) * [[1e-3], [1e-3], [2e-3], [1e-2], [3e-2], [1e-2]]
    # A product, as registration makes them: orthonormal only to rounding.
    T = random_transform(rng) * random_transform(rng) * random_transform(rng).inv()
    fields = {
        "status": Status.ACCEPTED,
        "reason": "all checks passed – Größe \u00b5T",
        "T_base_target": T,
        "covariance": factor @ factor.T,
        "probability": 0.1 + 0.2,
        "overlap": 1 / 3,
        "alternatives": (
            Alternative(random_transform(rng), 0.25, sd=(0.01, 0.2)),
            Alternative(random_transform(rng)),
        ),
        "degenerate_directions": (
            DegenerateDirection(np.array([0.0, -0.0, 0.6, 0.8, 0.0, 0.0]), "sliding along base x"),
        ),
        "sensor": {
            "bias": np.array([1e-7, -2e-7, 5e-324]),
            "scale": np.float64(1.01),
            "prior_sd": [1e-6],
            "calibrated": {"base": {"time_offset": 0.01, "matrix": np.eye(3), "shift": np.full(3, -1e-6)}},
        },
        "residual": 1.0,
        "fitness": 1.2345678901234567e-7,
        "n_inliers": 12,
        "n_keypoints": 345,
        "n_correspondences": 67,
        "links": Links(rng.normal(size=(40, 3)), rng.normal(size=(40, 3))),
        "seconds": {"search": 0.5, "total": 1.25},
        "config": {"field": {"prior": "spline", "domain": None}, "levels": (1, 2.0)},
        "version": "0.1.0",
        "seed": 7,
        "inputs": ({"name": "a.csv", "sha256": "0" * 64}, {"name": "b.csv", "sha256": "1" * 64}),
        "base": "hall",
    }
    return RegistrationResult(**(fields | changes))


def rewrite(path, change, *, keep_checksum=False):
    """Edit a saved result as a user or another program would."""
    document = json.loads(path.read_text())
    if not keep_checksum:
        document.pop("checksum", None)
    change(document)
    path.write_text(json.dumps(document))
    return path


@pytest.fixture
def saved(tmp_path):
    accepted().save(tmp_path / "r.json")
    return tmp_path / "r.json"


def test_file_has_the_keys_of_the_interface_in_order(saved):
    document = json.loads(saved.read_text())
    assert list(document) == [KEYS[0], "checksum", *KEYS[1:]]
    assert document["schema"] == "magmatch.registration/1"
    assert np.shape(document["T_base_target"]) == (4, 4)
    assert np.shape(document["covariance"]) == (6, 6)
    assert set(document["alternatives"][0]) == {"T_base_target", "probability", "log_odds", "sd"}
    assert len(document["degenerate_directions"][0]["xi"]) == 6


@given(seed=st.integers(0, 10_000))
@few
def test_what_was_saved_comes_back_to_the_bit_and_is_saved_in_the_same_bytes(tmp_path_factory, seed):
    folder, before = tmp_path_factory.mktemp("r"), accepted(seed)
    before.save(folder / "a.json")
    after = RegistrationResult.load(folder / "a.json")
    assert after.to_dict() == before.to_dict()
    assert np.array_equal(after.T_base_target.rotation.as_quat(), before.T_base_target.rotation.as_quat())
    after.save(folder / "b.json")
    assert (folder / "a.json").read_bytes() == (folder / "b.json").read_bytes()


def test_refusal_has_no_transform_and_comes_back(tmp_path):
    RegistrationResult(Status.AMBIGUOUS, "so it is", None, alternatives=accepted().alternatives).save(tmp_path / "r")
    after = RegistrationResult.load(tmp_path / "r")
    assert (after.status, after.T_base_target, after.covariance) == (Status.AMBIGUOUS, None, None)
    assert len(after.alternatives) == 2


def test_nan_is_written_as_null_and_stays_readable(tmp_path):
    result = accepted(
        overlap=math.nan,
        residual=math.inf,
        fitness=np.float64("nan"),
        covariance=np.full((6, 6), np.nan),
        sensor={"bias": [math.nan, 0.0, 0.0]},
        seconds={"search": math.nan},
        links=Links(np.array([[0.0, 0, 0], [np.nan, 0, 0]]), np.zeros((2, 3))),
    )
    result.save(tmp_path / "r.json")
    text = (tmp_path / "r.json").read_text()
    assert "NaN" not in text
    assert "Infinity" not in text
    after = RegistrationResult.load(tmp_path / "r.json")
    assert after.residual is None
    assert after.covariance is None
    assert len(after.links.base) == 1
    after.save(tmp_path / "s.json")
    assert (tmp_path / "s.json").read_text() == text


def test_what_json_cannot_hold_is_named(tmp_path):
    with pytest.raises(TypeError, match=r"'config\.levels' holds a set"):
        accepted(config={"levels": {1}}).save(tmp_path / "r.json")
    assert not list(tmp_path.iterdir())


def test_edited_number_is_noticed_and_the_way_out_is_named(saved):
    rewrite(saved, lambda d: d["T_base_target"][0].__setitem__(3, 1.0), keep_checksum=True)
    with pytest.raises(DataFormatError, match=r"changed after it was written; .*delete the key 'checksum'"):
        RegistrationResult.load(saved)
    rewrite(saved, lambda d: None)
    assert RegistrationResult.load(saved).T_base_target.translation[0] == 1.0


def test_reordered_and_reformatted_file_is_the_same(saved):
    document = json.loads(saved.read_text())
    document = {key: document[key] for key in sorted(document)} | {"residual": 1}
    saved.write_text("\ufeff" + json.dumps(document, indent=3), encoding="utf-8")
    assert RegistrationResult.load(saved).residual == 1.0


def test_file_from_elsewhere_needs_schema_status_and_transform_only(tmp_path):
    path = tmp_path / "r.json"
    T = np.eye(4).tolist()
    path.write_text(
        json.dumps({"schema": "magmatch.registration/1", "status": "accepted", "T_base_target": T, "x": 1})
    )
    np.testing.assert_array_equal(RegistrationResult.load(path).T_base_target.as_matrix(), T)


BAD = {
    "status unknown": ("status", "fine", "expected 'accepted', 'ambiguous'"),
    "reason a number": ("reason", 3, "expected a valid string, found 3"),
    "transform missing": ("T_base_target", None, "null with 'accepted'"),
    "transform transposed": ("T_base_target", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [1, 2, 3, 1]], "last row"),
    "transform scaled": ("T_base_target", np.diag([2.0, 2, 2, 1]).tolist(), "off orthonormal by 3"),
    "transform a reflection": ("T_base_target", np.diag([1.0, 1, -1, 1]).tolist(), "reflection"),
    "covariance not symmetric": ("covariance", np.triu(np.full((6, 6), 0.1) + np.eye(6)).tolist(), "symmetric"),
    "covariance not semidefinite": ("covariance", (np.full((6, 6), 2.0) - np.eye(6)).tolist(), "semidefinite"),
    "covariance negative": ("covariance", (-np.eye(6)).tolist(), "not negative"),
    "probability above one": ("probability", 1.5, "expected less than or equal to 1"),
    "overlap negative": ("overlap", -0.1, "expected greater than or equal to 0"),
    "direction not unit": ("degenerate_directions", [{"xi": [1, 1, 0, 0, 0, 0], "words": ""}], "unit vector"),
    "links unequal": (
        "links",
        {"base": [[0, 0, 0]], "target": []},
        r"equal numbers of points, at most 300, found \[1, 0\]",
    ),
    "number huge": ("residual", 10**400, "expected a valid number"),
}


@pytest.mark.parametrize("case", BAD)
def test_impossible_value_is_refused_by_its_key(saved, case):
    key, value, message = BAD[case]
    rewrite(saved, lambda d: d.__setitem__(key, value))
    with pytest.raises(DataFormatError, match=message) as caught:
        RegistrationResult.load(saved)
    assert re.search(rf"r\.json: key '{key}[.']", str(caught.value))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not a registration result"),
        (b'{"status": "accepted"}', "key 'schema': expected"),
        (b'{"schema": "magmatch.registration/2"}', "written by another version of magmatch: update"),
        (b'{"schema": "magmatch.registration/1", "residual": 1e999}', "1e999 is not a JSON number"),
        (b'{"schema": "magmatch.registration/1", "schema": 1}', "appears twice"),
        (b"[" * 100_000, "is not a registration result"),
    ],
)
def test_other_file_is_refused_in_one_line(tmp_path, content, message):
    path = tmp_path / "r.json"
    path.write_bytes(content)
    with pytest.raises(DataFormatError, match=message) as caught:
        RegistrationResult.load(path)
    assert "\n" not in str(caught.value)


def test_transform_is_given_exactly_where_accepted(saved):
    rewrite(saved, lambda d: d.update(status="ambiguous"))
    with pytest.raises(DataFormatError, match="given with 'ambiguous'"):
        RegistrationResult.load(saved)


def test_matrix_written_with_ten_digits_becomes_a_rotation():
    matrix = random_transform(np.random.default_rng(3)).as_matrix()
    T = transform_from_matrix(np.round(matrix, 10))
    R = T.rotation.as_matrix()
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
    assert np.abs(T.as_matrix() - matrix).max() < 1e-9
    assert np.array_equal(transform_from_matrix(T.as_matrix()).as_matrix(), T.as_matrix())


def test_damage_that_takes_the_end_or_renames_the_checksum_is_noticed(saved):
    whole = saved.read_text()
    saved.write_text(whole[: whole.index("],", whole.index('"T_base_target"')) + 1] + "]}")
    with pytest.raises(DataFormatError, match=r"not a registration result|changed after"):
        RegistrationResult.load(saved)
    saved.write_text(whole[: whole.index(',\n  "covariance"')] + "\n}\n")
    with pytest.raises(DataFormatError, match="changed after it was written"):
        RegistrationResult.load(saved)
    saved.write_text(whole.replace('"checksum"', '"check_um"'))
    with pytest.raises(DataFormatError, match="'check_um' seems to be a damaged 'checksum'"):
        RegistrationResult.load(saved)


def survey(seed=0, n=50, **changes):
    rng = np.random.default_rng(seed)
    fields = {
        "positions": rng.normal(size=(n, 3)),
        "field": rng.normal(size=(n, 3)) * 1e-5,
        "times": np.arange(n) * 0.1,
        "orientations": Rotation.random(n, rng=rng),
        "pose_sd": 0.01,
    }
    return Survey(**(fields | changes))


def test_hash_does_not_depend_on_the_file_format_or_name(tmp_path):
    before = survey(name="room", frame="odom")
    before.save(tmp_path / "other.csv")
    after = Survey.load(tmp_path / "other.csv")
    assert after.name != before.name
    assert hash_survey(after) == hash_survey(before)
    flipped = survey(orientations=Rotation(-before.orientations.as_quat(), normalize=False))
    assert hash_survey(flipped) == hash_survey(before)
    assert describe_input(after) == {"name": "other.csv", "sha256": hash_survey(before)}


@pytest.mark.parametrize("name", ["positions", "field", "times", "pose_sd", "orientations"])
def test_hash_changes_with_the_content(name):
    one = survey()
    value = getattr(one, name)
    if name == "orientations":
        changed = value * Rotation.from_rotvec([1e-6, 0, 0])
    elif name == "pose_sd":
        changed = np.nextafter(value, 1)
    else:
        changed = value.copy()
        changed.flat[17] = np.nextafter(changed.flat[17], np.inf)
    assert hash_survey(survey(**{name: changed})) != hash_survey(one)


def test_hash_tells_missing_times_from_given_ones():
    assert len({hash_survey(survey(times=None)), hash_survey(survey()), hash_survey(survey(orientations=None))}) == 3
