"""Claims about the places that do not exist: lawful, of the same statistics, and consistent with themselves."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.features.invariants import rotation_invariants, traceless_symmetric
from magmatch.registration.config import PRESETS
from magmatch.registration.prepared.pose_prior import PosePrior
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.refine.refinement import refine
from magmatch.registration.search.invariant_search import invariant_search
from magmatch.registration.weigh.decoys import decoys
from magmatch.registration.weigh.evidence import null_model_of, weigh_pose

CONFIG = PRESETS["default"]
FLAT = PosePrior(volume=10.0)


@pytest.fixture(scope="module")
def prepared(make_exact_pair):
    rng = np.random.default_rng(0)
    return tuple(prepare(m, 4, rng) for m in make_exact_pair(3, RigidTransform.identity()))


@pytest.fixture(scope="module")
def places(prepared):
    return [place for place, _ in decoys(prepared[0], FLAT)]


def test_their_gradient_is_symmetric_and_traceless_and_the_slope_of_their_field(places):
    for place in places:
        p, step = place.points[:40], 1e-5
        gradient = place.posterior.evaluate(p, order=1).gradient
        for axis in range(3):
            ahead, behind = (place.posterior.evaluate(p + s * step * np.eye(3)[axis]).field for s in (1, -1))
            np.testing.assert_allclose(gradient[:, :, axis], (ahead - behind) / (2 * step), atol=1e-9, rtol=1e-4)
        lawful = traceless_symmetric(gradient)
        assert np.abs(gradient - lawful).max() < 0.1 * np.abs(gradient).max()


def test_their_invariants_are_those_of_their_own_field(places):
    for place in places:
        expected = rotation_invariants(place.point_field, place.point_gradient)
        np.testing.assert_allclose(place.invariants, expected, rtol=1e-9, atol=1e-18)


def test_their_raster_and_samples_show_their_own_field(prepared, places):
    for place in places:
        field, _, _, is_known = place.raster.lookup(place.points)
        exact = place.posterior.evaluate(place.points).field
        assert is_known.mean() > 0.9
        assert np.quantile(np.abs(field - exact)[is_known], 0.98) < 1e-6
        np.testing.assert_allclose(
            np.linalg.norm(place.sample_field, axis=1), np.linalg.norm(prepared[0].sample_field, axis=1)
        )


def test_a_target_is_found_in_its_place_and_in_none_of_the_decoys(prepared, places):
    base, target = prepared
    null = null_model_of(base, target)

    def best(place):
        rng = np.random.default_rng(0)
        found = invariant_search(place, target, FLAT, CONFIG.invariants, rng)
        pose = refine(place, target, found.candidates[0].T_base_target, FLAT, CONFIG.refinement, rng)
        return weigh_pose(place, target, pose, null, FLAT).log_evidence

    reached = [best(place) for place in places]
    assert best(base) > 100
    assert max(reached) < 40
