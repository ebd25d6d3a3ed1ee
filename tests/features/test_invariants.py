"""Laws of the point invariants and point frames."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from magmatch.features.invariants import point_frames, rotation_invariants, traceless_symmetric


def random_point(seed, n=20):
    rng = np.random.default_rng(seed)
    return 5e-5 * rng.normal(size=(n, 3)), traceless_symmetric(2e-5 * rng.normal(size=(n, 3, 3)))


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_invariants_are_unchanged_by_rotation(seed):
    field, gradient = random_point(seed)
    R = Rotation.random(rng=np.random.default_rng(seed + 1)).as_matrix()
    turned = rotation_invariants(field @ R.T, R @ gradient @ R.T)
    reference = rotation_invariants(field, gradient)
    assert np.all(np.abs(turned - reference) < 1e-9 * np.abs(reference).max(axis=0))


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_frames_turn_with_the_field(seed):
    field, gradient = random_point(seed)
    R = Rotation.random(rng=np.random.default_rng(seed + 1)).as_matrix()
    np.testing.assert_allclose(
        point_frames(field @ R.T, R @ gradient @ R.T), R @ point_frames(field, gradient), atol=1e-7
    )


def test_chirality_changes_sign_in_the_mirror():
    field, gradient = random_point(2)
    mirror = np.diag([1.0, 1.0, -1.0])
    reference = rotation_invariants(field, gradient)
    mirrored = rotation_invariants(field @ mirror, mirror @ gradient @ mirror)
    np.testing.assert_allclose(mirrored[:, 5], -reference[:, 5], rtol=1e-9)
    np.testing.assert_allclose(mirrored[:, :5], reference[:, :5], rtol=1e-9)


def test_lawful_gradient_is_symmetric_and_traceless():
    _, gradient = random_point(3)
    np.testing.assert_allclose(gradient, np.swapaxes(gradient, 1, 2))
    np.testing.assert_allclose(np.trace(gradient, axis1=1, axis2=2), 0, atol=1e-18)
