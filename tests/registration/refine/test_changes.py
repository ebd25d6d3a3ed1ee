"""Claims about poses beside sources that were moved, on maps whose field is known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigvalsh
from scipy.spatial.transform import RigidTransform

from hand_made import EARTH, Polynomial, box, prepared_map, some_field
from magmatch.estimation.pose_prior import PosePrior
from magmatch.geometry import perturbation, random_transform, rotate_vectors, transform_error, transform_points
from magmatch.registration.prepared.drift import Drift
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.refine import changes
from magmatch.registration.refine.changes import MAX_MISFIT, refine_beside_changes
from magmatch.registration.refine.refinement import refine
from magmatch.registration.weigh import change_search
from magmatch.registration.weigh.cells import agreeing_cells, compare_cells, null_models_of
from magmatch.registration.weigh.change_search import ChangeSearch
from magmatch.registration.weigh.covariance import drift_covariance, joint_covariance
from magmatch.registration.weigh.evidence import weigh_pose

FLAT = PosePrior(10.0)


@pytest.fixture(scope="module", autouse=True)
def small_room():
    """It takes fewer samples, and one candidate is enough."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(changes, "CHANGE_SAMPLES", 600)
        patch.setattr(change_search, "N_CHANGED", 1)
        yield


@pytest.fixture
def few_charges(monkeypatch):
    monkeypatch.setattr(changes, "N_CHARGES", 100)


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
    return refine(base, target, T_model, FLAT, "auto", np.random.default_rng(0))


@pytest.fixture(scope="module")
def nulls(moved):
    return null_models_of(*moved[:2])


@pytest.fixture(scope="module")
def whole(moved, ordinary, nulls):
    return weigh_pose(*moved[:2], ordinary, nulls, FLAT)


def pose_beside(base, target, start, agrees=None):
    """A pose refined beside a change, of samples that agree: all, unless others are named."""
    agrees = np.ones(len(target.samples), dtype=bool) if agrees is None else agrees
    return refine_beside_changes(base, target, start, agrees, FLAT, np.random.default_rng(0))


@pytest.fixture(scope="module")
def beside(moved, ordinary, nulls):
    base, target, T_model, _ = moved
    seen = compare_cells(base, target, T_model, target.sample_field, nulls.target)
    agrees = nulls.target.cells.holds(agreeing_cells(seen, nulls.target)[0])
    return pose_beside(base, target, replace(ordinary, T_base_target=T_model), agrees)


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
    assert beside.noise < 1.1


def test_stated_drift_spreads_a_pose_beside_a_change_as_residuals_do(moved, ordinary):
    """Each about as much more than without the change: one selection of charges answers both."""
    base, target, T_model, _ = moved
    n = len(target.samples)
    drifting = replace(target, drift=Drift(0.02, 0.02, np.arange(n), np.eye(n)))
    found = pose_beside(base, drifting, replace(ordinary, T_base_target=T_model))
    plain = refine(base, drifting, T_model, FLAT, "auto", np.random.default_rng(0))
    forward = replace(plain, blocks=plain.blocks[:1])
    by_drift, by_residuals = (
        np.sqrt(np.trace(spread(found.pose)) / np.trace(spread(forward)))
        for spread in (drift_covariance, lambda pose: joint_covariance(pose, 0.2)[:6, :6])
    )
    assert by_residuals / 3 < by_drift < 3 * by_residuals


def test_a_wrong_pose_is_no_likelier_beside_a_change_than_a_field_of_its_own(moved, ordinary, beside):
    base, target, T_model, _ = moved
    wrong = T_model * perturbation(np.array([0.0, 0.0, 2.5, 0.3, 0.2, 0.0]), ordinary.center)
    found = pose_beside(base, target, replace(ordinary, T_base_target=wrong))
    assert found.log_ratio < 50.0
    assert beside.log_ratio > found.log_ratio + 200.0


def test_cells_that_agree_are_those_where_little_changed(moved, nulls):
    base, target, T_model, change_at = moved
    seen = compare_cells(base, target, T_model, target.sample_field, nulls.target)
    rows, _, price = agreeing_cells(seen, nulls.target)
    size = np.linalg.norm(nulls.target.cells.mean(change_at(target.samples)), axis=1)
    others = np.setdiff1d(seen.rows, rows)
    assert len(others)
    assert price > 0
    assert np.median(size[others]) > 3 * np.median(size[rows])


def test_a_pose_beside_a_change_takes_the_place_of_one_that_leaves_a_misfit_and_more_cells_than_agree_tell(
    moved, ordinary, nulls, whole
):
    base, target, T_model, _ = moved
    assert whole.misfit > MAX_MISFIT
    best = ChangeSearch(base, target, nulls, FLAT, 0).poses([T_model], whole, ordinary)[0]
    assert best.is_beside_change
    assert best.misfit < 1.0
    seen = compare_cells(base, target, T_model, target.sample_field, nulls.target)
    assert len(agreeing_cells(seen, nulls.target)[0]) / len(seen.rows) < best.unchanged < 1.0
    assert distance(best.pose.T_base_target, T_model, target) < 0.003


def test_what_changed_may_also_be_left_out_and_not_estimated(moved, ordinary, nulls, whole):
    """Another model of the same pose, by the evidence of the cells that agree."""
    base, target, T_model, _ = moved
    search = ChangeSearch(base, target, nulls, FLAT, 0)
    estimated, left_out = sorted(search.poses([T_model], whole, ordinary), key=lambda one: one.model)
    assert (estimated.model, left_out.model) == ("rigid, changed", "rigid, without changed cells")
    rows, agreement, _, n_cells = search._agreement(left_out.pose)
    assert left_out.log_evidence == pytest.approx(agreement + left_out.price, abs=1.0)  # sensors are alike, to that
    assert left_out.unchanged == len(rows) / n_cells < 1
    assert left_out.log_evidence > 50
    assert left_out.pose is estimated.pose


def test_choices_of_cells_that_take_turns_end_with_one_of_them(moved, ordinary, nulls, monkeypatch):
    """Each leads to a pose 5 cm from the other's."""
    base, target, T_model, _ = moved
    agreement, n_chosen = ChangeSearch._agreement, 0

    def choose(self, pose, *shares):
        nonlocal n_chosen
        n_chosen += 1
        return agreement(self, pose, *shares)

    def lead(*args):
        found = refine_beside_changes(*args)
        shift = RigidTransform.from_translation([0.0, 0.0, 0.05 * (n_chosen % 2)])
        return replace(found, pose=replace(found.pose, T_base_target=T_model * shift))

    monkeypatch.setattr(ChangeSearch, "_agreement", choose)
    monkeypatch.setattr(change_search, "refine_beside_changes", lead)
    start = replace(ordinary, T_base_target=T_model)
    assert ChangeSearch(base, target, nulls, FLAT, 0)._follow(start) is not None


@pytest.mark.usefixtures("few_charges")
def test_where_nothing_changed_the_odds_are_those_of_a_constant_field_beside_a_known_one():
    """A uniform field: what explains the target is known against drawn from a normal density, by hand."""
    rng, sd = np.random.default_rng(1), 0.3e-6
    base, target = (prepared_map(Polynomial(), box(rng, 120), rng, noise_sd=sd) for _ in range(2))
    here = RigidTransform.identity()
    known = PosePrior(10.0, here, 1e-6 * np.eye(6))  # of which a uniform field says nothing
    pose = replace(refine(base, target, here, known, "auto", rng), T_base_target=here)
    agrees = np.ones(120, dtype=bool)
    found = refine_beside_changes(base, target, pose, agrees, known, rng)
    # ln N(0; noise) - ln N(constant; CONSTANT^2 + noise / n); what noise leaves is as large on both sides.
    expected = 1.5 * np.log(1 + 120 * (1e-4 / sd) ** 2) + 0.5 * (EARTH**2).sum() / 1e-4**2
    assert found.log_ratio == pytest.approx(expected, abs=6)


@pytest.mark.usefixtures("few_charges")
def test_charges_that_stand_for_nothing_leave_turns_as_well_known_and_scores_that_scatter_as_stated():
    """Against a refinement without them; they answer a shift, a turn of the Earth's field hardly."""
    rng = np.random.default_rng(2)
    base, target = (prepared_map(some_field(3, bend=40e-6), box(rng, 400), rng) for _ in range(2))
    ordinary = refine(base, target, RigidTransform.identity(), FLAT, "auto", rng)
    found = pose_beside(base, target, ordinary)
    (block,), scores = found.pose.blocks, found.pose.blocks[0].scores[:, :6]
    # That the same data chose the charges counts sixteenfold.
    information = 16 * block.information[:6, :6]
    share = eigvalsh(information, ordinary.blocks[0].information[:6, :6])
    assert 0 < share[0] < 0.3
    assert 0.7 < share[3] < share[5] < 1
    np.testing.assert_allclose(block.information, block.information.T, rtol=1e-9, atol=1e-9 * block.information.max())
    np.testing.assert_array_equal(block.curvature, block.information)
    scatter = eigvalsh(16 * scores.T @ scores, information)
    assert 0.4 < scatter.min() < scatter.max() < 1.4
    # At rest: what is left to go is a fraction of a standard deviation.
    assert 16 * scores.sum(axis=0) @ np.linalg.solve(information, scores.sum(axis=0)) < 0.5
    assert block.residual2.mean() == pytest.approx(3 * found.noise, rel=0.1)


def test_nothing_is_looked_for_where_residuals_are_explained(make_exact_pair):
    T_base_target = random_transform(np.random.default_rng(3))
    rng = np.random.default_rng(0)
    base, target = (prepare(m, 4, rng) for m in make_exact_pair(5, T_base_target))
    T_model = base.T_map_model.inv() * T_base_target * target.T_map_model
    nulls = null_models_of(base, target)
    pose = refine(base, target, T_model, FLAT, "auto", rng)
    best = weigh_pose(base, target, pose, nulls, FLAT)
    assert ChangeSearch(base, target, nulls, FLAT, 0).poses([T_model], best, pose) == []


def test_too_few_samples_that_agree_give_no_pose(moved, ordinary):
    base, target, _, _ = moved
    assert pose_beside(base, target, ordinary, np.zeros(len(target.samples), dtype=bool)) is None


def test_where_nothing_tells_of_the_pose_none_is_stated(moved, ordinary, monkeypatch):
    base, target, _, _ = moved
    look_up = changes._look_up

    def as_out_of_the_base(*given):
        found = look_up(*given)
        return replace(
            found, gradient=0 * found.gradient, target_side=0 * found.target_side, base_side=0 * found.base_side
        )

    monkeypatch.setattr(changes, "_look_up", as_out_of_the_base)
    assert pose_beside(base, target, ordinary) is None
