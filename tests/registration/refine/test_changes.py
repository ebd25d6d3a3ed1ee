"""Claims about poses beside sources that were moved, on maps whose field is known exactly."""

from dataclasses import replace

import numpy as np
import pytest

from magmatch.geometry import random_transform, rotate_vectors, transform_error, transform_points
from magmatch.registration.prepared.pose_prior import PosePrior
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.refine.changes import ChangeConfig, refine_beside_changes
from magmatch.registration.refine.refinement import RefinementConfig, perturbation, refine
from magmatch.registration.weigh import change_search
from magmatch.registration.weigh.change_search import poses_beside_changes
from magmatch.registration.weigh.evidence import agreeing_cells, compare_cells, null_model_of, weigh_pose

FLAT = PosePrior(10.0)
# One candidate, in a small room.
REFINEMENT, CONFIG = RefinementConfig(), ChangeConfig(n_samples=600, n_candidates=1)


@pytest.fixture(scope="module")
def moved(make_moved_pair):
    """Two of forty dipoles, the strongest, stand half a metre elsewhere."""
    T_base_target = random_transform(np.random.default_rng(3))
    base_map, target_map, change = make_moved_pair(5, T_base_target, 2)
    rng = np.random.default_rng(0)
    base, target = prepare(base_map, 4, rng), prepare(target_map, 4, rng)
    T_model = base.T_map_model.inv() * T_base_target * target.T_map_model

    def change_at(points):
        """In the target's model frame, whose axes the base's world is turned to."""
        T_world_model = T_base_target * target.T_map_model
        return rotate_vectors(change(transform_points(points, T_world_model)), T_world_model.inv())

    return base, target, T_model, change_at


@pytest.fixture(scope="module")
def ordinary(moved):
    base, target, T_model, _ = moved
    return refine(base, target, T_model, FLAT, REFINEMENT, np.random.default_rng(0))


@pytest.fixture(scope="module")
def beside(moved, ordinary):
    base, target, T_model, _ = moved
    null_model = null_model_of(base, target)
    seen = compare_cells(base, target, T_model, target.sample_field, null_model)
    agrees = null_model.cells.holds(agreeing_cells(seen, null_model)[0])
    return refine_beside_changes(
        base, target, replace(ordinary, T_base_target=T_model), agrees, FLAT, CONFIG, np.random.default_rng(0)
    )


def distance(T, T_true, target):
    return transform_error(T, T_true, target.samples.mean(axis=0))[0]


def test_sources_that_moved_pull_a_dense_refinement_along_but_not_one_beside_the_change(moved, ordinary, beside):
    _, target, T_model, _ = moved
    pulled, free = (distance(p.T_base_target, T_model, target) for p in (ordinary, beside.pose))
    assert free < 0.003
    assert pulled > 3 * free


def test_the_change_is_what_the_moved_sources_make(moved, beside):
    _, target, _, change_at = moved
    true = change_at(target.samples)
    missed = beside.change_at(target.samples) - true
    # Under the noise of one component, where single samples changed by up to twenty times that.
    assert np.median(np.linalg.norm(missed, axis=1)) < 0.3e-6 < 0.3 * np.median(np.linalg.norm(true, axis=1))
    assert beside.noise < CONFIG.max_noise


def test_a_wrong_pose_is_no_likelier_beside_a_change_than_a_field_of_its_own(moved, ordinary, beside):
    base, target, T_model, _ = moved
    wrong = T_model * perturbation(np.array([0.0, 0.0, 2.5, 0.3, 0.2, 0.0]), ordinary.center)
    agrees = np.ones(len(target.samples), dtype=bool)
    start = replace(ordinary, T_base_target=wrong)
    found = refine_beside_changes(base, target, start, agrees, FLAT, CONFIG, np.random.default_rng(0))
    assert found.log_ratio < 50.0
    assert beside.log_ratio > found.log_ratio + 200.0


def test_cells_that_agree_are_those_where_little_changed(moved):
    base, target, T_model, change_at = moved
    null_model = null_model_of(base, target)
    seen = compare_cells(base, target, T_model, target.sample_field, null_model)
    rows, _, price = agreeing_cells(seen, null_model)
    size = np.linalg.norm(null_model.cells.mean(change_at(target.samples)), axis=1)
    others = np.setdiff1d(seen.rows, rows)
    assert len(others)
    assert price > 0
    assert np.median(size[others]) > 3 * np.median(size[rows])


def test_a_pose_beside_a_change_takes_the_place_of_one_that_leaves_a_misfit(moved, ordinary):
    base, target, T_model, _ = moved
    null_model = null_model_of(base, target)
    whole = weigh_pose(base, target, ordinary, null_model, FLAT)
    assert whole.misfit > CONFIG.max_misfit
    best = poses_beside_changes(base, target, [T_model], whole, ordinary, null_model, FLAT, CONFIG, 0)[0]
    assert best.is_beside_change
    assert best.misfit < 1.0
    assert best.unchanged < 1.0
    assert distance(best.pose.T_base_target, T_model, target) < 0.003


def test_more_cells_than_agree_tell_beside_the_change(moved, ordinary, monkeypatch):
    base, target, T_model, _ = moved
    null_model = null_model_of(base, target)
    whole = weigh_pose(base, target, ordinary, null_model, FLAT)

    def best():
        return poses_beside_changes(base, target, [T_model], whole, ordinary, null_model, FLAT, CONFIG, 0)[0]

    wide = best()
    monkeypatch.setattr(change_search, "WIDER_SHARES", ())
    alone = best()
    assert wide.unchanged > alone.unchanged
    assert wide.log_evidence > alone.log_evidence + 10
    assert distance(wide.pose.T_base_target, T_model, target) < 0.003


def test_nothing_is_looked_for_where_residuals_are_explained(make_exact_pair):
    T_base_target = random_transform(np.random.default_rng(3))
    rng = np.random.default_rng(0)
    base, target = (prepare(m, 4, rng) for m in make_exact_pair(5, T_base_target))
    T_model = base.T_map_model.inv() * T_base_target * target.T_map_model
    null_model = null_model_of(base, target)
    pose = refine(base, target, T_model, FLAT, REFINEMENT, rng)
    best = weigh_pose(base, target, pose, null_model, FLAT)
    assert poses_beside_changes(base, target, [T_model], best, pose, null_model, FLAT, CONFIG, 0) == []


def test_too_few_samples_that_agree_give_no_pose(moved, ordinary):
    base, target, _, _ = moved
    nothing = np.zeros(len(target.samples), dtype=bool)
    assert refine_beside_changes(base, target, ordinary, nothing, FLAT, CONFIG, np.random.default_rng(0)) is None
