# SPDX-License-Identifier: BSD-3-Clause
"""Laws and choices of the keypoint detector."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.features.config import FeatureConfig
from magmatch.features.infer import infer
from magmatch.features.keypoints import block_variance, curvature_response, detect, magnitude_hessian
from magmatch.field.values import FieldValues

LAW = settings(max_examples=15, deadline=None)
COARSE = FeatureConfig(spacing=0.2, axes="principal")


def some_points(seed, n=20):
    return np.random.default_rng(seed + 7).uniform(0.1, [2.3, 1.9, 0.5], (n, 3))


def magnitude(source, x):
    return np.linalg.norm(source.values(x, 0).field, axis=1)


@given(seed=st.integers(0, 1000))
@LAW
def test_hessian_is_that_of_finite_differences(make_room, seed):
    source, x, h = make_room(seed), some_points(seed), 2e-4
    hessian = magnitude_hessian(source.values(x, 2))
    for i in range(3):
        for j in range(3):
            a, b = h * np.eye(3)[i], h * np.eye(3)[j]
            corners = [magnitude(source, x + s * a + t * b) * s * t for s in (-1, 1) for t in (-1, 1)]
            # What a step of 0.2 mm leaves out, beside a source or where the field nearly vanishes.
            np.testing.assert_allclose(
                sum(corners) / (4 * h * h), hessian[:, i, j], rtol=1e-3, atol=1e-4 * np.abs(hessian).max()
            )


def test_a_field_that_vanishes_has_no_curvature_and_no_warning():
    values = FieldValues(np.zeros((2, 3)), np.ones((2, 3, 3)), np.ones((2, 3, 3, 3)))
    assert np.isnan(curvature_response(values)).all()


def detected(field_map, config):
    inferred = infer(field_map, config)
    return inferred, curvature_response(inferred.values), detect(inferred, config)


def test_keypoints_respond_more_than_the_mean(make_map):
    _, response, rows = detected(make_map(1), COARSE)
    assert len(rows) > 5
    assert np.all(response[rows] > response.mean())


def test_no_keypoint_has_a_negative_response_though_the_mean_is_negative(make_map, monkeypatch):
    inferred, response, rows = detected(make_map(1), COARSE)
    wild = np.where(np.arange(len(response)) % 150 == 0, -1e4 * np.abs(response).max(), response)
    monkeypatch.setattr("magmatch.features.keypoints.curvature_response", lambda _: wild)
    found = detect(inferred, COARSE)
    assert wild.mean() < 0
    assert len(found) > len(rows)
    assert (wild[found] > 0).all()


def test_points_with_high_variance_are_dropped(make_map):
    field_map = make_map(1)
    every = COARSE.model_copy(update={"variance_quantile": 1.0})
    few = COARSE.model_copy(update={"variance_quantile": 0.5})
    points, _, all_rows = detected(field_map, every)
    _, _, rows = detected(field_map, few)
    variance = block_variance(points, np.arange(len(points)))
    dropped = np.setdiff1d(all_rows, rows)
    assert 0.5 * len(all_rows) <= len(rows) < len(all_rows)
    assert variance[rows].max() < variance[dropped].min()


def test_variance_of_a_block_is_that_nearby(make_map):
    field_map = make_map(1)
    points = infer(field_map, COARSE)
    rows = np.arange(len(points))
    exact = np.trace(field_map.covariance(points.positions), axis1=1, axis2=2) / 3
    slope = 1e-14 / field_map.posterior.high[0]
    np.testing.assert_allclose(block_variance(points, rows), exact, rtol=0, atol=0.51 * 0.2 * slope)
