# SPDX-License-Identifier: BSD-3-Clause
"""Messages: whatever comes is samples or a refusal, and what goes out comes back as it was."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.localization.estimate import LocalizerStatus, PoseEstimate
from magmatch_serve.messages import POSE, SAMPLE, read_hello, read_pose, read_samples, write_pose, write_sample
from magmatch_serve.refusals import RefusedError

NUMBERS = st.floats(-1e3, 1e3)
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner, max_size=4),
    max_leaves=9,
)
UTM = np.array([691234.5, 5334567.25, 512.0])
SAMPLES = st.fixed_dictionaries(
    {"t": ANYTHING | NUMBERS, "position": ANYTHING | st.lists(NUMBERS, min_size=3, max_size=3),
     "orientation": ANYTHING | st.just([0, 0, 0, 1]), "field": ANYTHING | st.lists(NUMBERS, min_size=3, max_size=3)},
    optional={"name": ANYTHING},
)  # fmt: skip


def or_refusal(function, *arguments):
    try:
        return function(*arguments)
    except RefusedError as refused:
        return refused


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=300) | st.text(max_size=99) | (ANYTHING | SAMPLES | st.lists(SAMPLES)).map(json.dumps))
def test_any_message_is_finite_samples_or_a_refusal(message):
    found = or_refusal(read_samples, message, 5)
    if isinstance(found, RefusedError):
        assert found.status in {400, 413, 422}
        assert "\n" not in found.message
        return
    assert all(np.isfinite(part).all() for part in found)
    R = found[1][:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-12)


def test_a_message_says_poses_and_which_is_none():
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5])
    row = {
        "t": 1.0,
        "position": [1.0, 2.0, 3.0],
        "orientation": (1.001 * turn.as_quat()).tolist(),
        "field": [0, 0, 5e-5],
    }
    times, poses, field = read_samples(json.dumps({"samples": [row, row | {"t": 2.0}]}), 2)
    np.testing.assert_allclose(poses, np.tile(RigidTransform.from_components([1, 2, 3], turn).as_matrix(), (2, 1, 1)))
    assert (times.tolist(), field.tolist()) == ([1.0, 2.0], [[0, 0, 5e-5]] * 2)
    with pytest.raises(RefusedError, match="of norm 1"):
        read_samples(json.dumps(row | {"orientation": [0, 0, 1.3, 0]}), 1)


@settings(max_examples=100, deadline=None)
@given(ANYTHING.map(json.dumps) | st.text(max_size=99))
def test_any_hello_is_one_or_a_refusal(message):
    found = or_refusal(read_hello, message)
    assert not isinstance(found, RefusedError) or found.status in {400, 422}


def stated(rng):
    T = RigidTransform.from_exp_coords(rng.normal(size=6))
    A = rng.normal(size=(6, 6))
    return PoseEstimate(LocalizerStatus.LOCALIZED, "why", T.as_matrix(), A @ A.T, 0.999, map="hall")


def test_a_pose_comes_back_as_it_was():
    now = stated(np.random.default_rng(0))
    for binary in (False, True):
        said = read_pose(write_pose(7, 1.25, now, binary=binary))
        assert (said["n"], said["t"], said["status"], said["probability"]) == (7, 1.25, "localized", 0.999)
        np.testing.assert_array_equal(said["T_map_body"], now.T_map_body.as_matrix())
        np.testing.assert_allclose(said["covariance"], now.covariance, rtol=0 if not binary else 1e-6)


@pytest.mark.parametrize("binary", [False, True])
def test_where_nothing_is_stated_no_pose_is_said(binary):
    said = read_pose(write_pose(1, 0.0, PoseEstimate(LocalizerStatus.LOST, "why"), binary=binary))
    assert said["status"] == "lost"
    assert "T_map_body" not in said


def test_no_number_that_json_lacks_goes_out():
    now = stated(np.random.default_rng(0))
    now.covariance[0, 0] = math.inf
    with pytest.raises(ValueError, match="JSON"):
        write_pose(1, 0.0, now, binary=False)


def test_a_binary_sample_holds_what_a_json_one_does():
    row = {
        "t": 1e9 + 0.25,
        "position": [1.5, -2.25, 0.5],
        "orientation": [0.0, 0, 0.6, 0.8],
        "field": [2e-5, 0, 4e-5],
    }
    packed = write_sample(*(np.array(row[key]) for key in row))
    assert len(packed) == SAMPLE.itemsize == 48
    for a, b in zip(read_samples(packed, 1), read_samples(json.dumps(row), 1), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7)
    assert POSE.size == 204


def test_a_binary_position_that_float32_cannot_hold_is_refused():
    q, b = np.array([0.0, 0, 0, 1]), np.array([2e-5, 0, 4e-5])
    near, far = write_sample(1.0, np.array([16_383.0, 0, -16_383.0]), q, b), write_sample(2.0, UTM, q, b)
    assert len(read_samples(near, 1)[0]) == 1
    with pytest.raises(RefusedError, match=r"position: expected less than 16 km .* take the first position off"):
        read_samples(near + far, 2)
    row = {"t": 2.0, "position": UTM.tolist(), "orientation": q.tolist(), "field": b.tolist()}
    np.testing.assert_array_equal(read_samples(json.dumps(row), 1)[1][0, :3, 3], UTM)
