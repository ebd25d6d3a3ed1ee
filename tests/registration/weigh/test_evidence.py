# SPDX-License-Identifier: BSD-3-Clause
"""What speaks for a pose, term by term, and whatever frames and units the surveys are in."""

from dataclasses import replace
from math import comb

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from hand_made import box, prepared_map, seen_from, some_field, turn_about
from magmatch.estimation.pose_prior import PosePrior
from magmatch.registration.refine.refinement import _at, compare
from magmatch.registration.weigh.cells import CellComparison, agreeing_cells, compare_cells, null_models_of
from magmatch.registration.weigh.covariance import joint_covariance
from magmatch.registration.weigh.evidence import weigh_pose

FIELD = some_field(3, slope=10e-6, bend=0.0)  # linear: what is interpolated is exact, in every frame
PRIOR = PosePrior(10.0)
HERE = RigidTransform.identity()
SD = 0.2e-6


@pytest.fixture(scope="module")
def pair():
    rng = np.random.default_rng(0)
    base = prepared_map(FIELD, box(rng, 300, (2.6, 2.2, 1.4)), rng, sd=SD, length=0.5)
    return base, prepared_map(FIELD, box(rng, 300), rng, length=0.5)


def pose_at(base, target, T=HERE, mode="none"):
    pose = _at(T, target.samples.mean(axis=0), mode, -1 if mode == "none" else 1, None)
    rows = np.arange(len(target.samples)), np.arange(len(base.samples))
    return replace(pose, blocks=compare(base, target, pose, rows))


def weighed(base, target, T=HERE):
    """What speaks for a pose of sensors that are alike."""
    return weigh_pose(base, target, pose_at(base, target, T), null_models_of(base, target), PRIOR)


def test_evidence_is_odds_of_the_cells_and_the_share_of_all_poses_that_the_estimate_fills(pair):
    base, target = pair
    pose, nulls = pose_at(base, target), null_models_of(base, target)
    found = weigh_pose(base, target, pose, nulls, PRIOR)
    # The base's cells inside the target, and the target's inside the base: two estimates of one number.
    swapped = null_models_of(target, base).target
    sides = of_all(target, base, swapped), of_all(base, target, nulls.target)
    assert len(sides[0][2]) > 5
    ratios = [null.log_ratio(*of) for null, of in zip((swapped, nulls.target), sides, strict=True)]
    log_ratio, attainable = np.mean(ratios, axis=0)
    joint = joint_covariance(pose, 1.0)
    # Laplace's approximation: (2 pi)^(6/2) sqrt(det C) times the prior's density; of the sensor, as a share.
    scale = np.append(np.ones(6), pose.sensor_sd)
    log_det = np.linalg.slogdet(joint / np.outer(scale, scale))[1]
    price = 0.5 * log_det + 3 * np.log(2 * np.pi) - np.log(10.0 * 8 * np.pi**2)
    assert found.log_evidence == pytest.approx(log_ratio + price)
    assert found.attainable == pytest.approx(attainable + price)
    assert (found.kind, found.T_base_target) == ("map", pose.T_base_target)
    np.testing.assert_array_equal(found.covariance, joint[:6, :6])


def test_evidence_falls_by_half_the_sum_of_squares_of_what_the_sensors_must_differ(pair):
    """A target read by another sensor, corrected for it: the same cells, less the price of such a sensor."""
    base, target = pair
    pose, nulls = pose_at(base, target, mode="scale"), null_models_of(base, target)
    step = pose.sensor_sd * [0.5, -1.0, 2.0, 1.5]
    sensor = pose.sensor.stepped(step)

    def read_by(field):
        return field @ sensor.gain.T + sensor.bias

    values = target.raster.values.copy()
    values[..., :3] = read_by(values[..., :3])
    read = replace(target, sample_field=read_by(target.sample_field), raster=target.raster._replace(values=values))
    plain = weigh_pose(base, target, pose, nulls, PRIOR).log_evidence
    priced = weigh_pose(base, read, replace(pose, sensor=sensor), nulls, PRIOR).log_evidence
    assert plain - priced == pytest.approx(0.5 * (0.5**2 + 1 + 2**2 + 1.5**2), rel=1e-6)


def test_evidence_does_not_change_with_the_frames(pair):
    base, target = pair
    T = turn_about(np.zeros(3), np.array([0.01, -0.02, 0.01, 0.02, 0.0, -0.01]))
    here = weighed(base, target, T)
    # Cells are cubes of the model frames: these may change their axes, and their origins by whole cells.
    axes = Rotation.from_matrix([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    A, B = (
        RigidTransform.from_components(t, R) for t, R in (([1.0, -2.0, 3.0], axes), ([-4.0, 1.0, 2.0], axes.inv()))
    )
    base, target = seen_from(base, A, sd=SD), seen_from(target, B)
    moved = A * T * B.inv()
    there = weighed(base, target, moved)
    assert there.log_evidence == pytest.approx(here.log_evidence, rel=1e-6)
    for name in ("overlap", "residual", "misfit", "n_informative", "n_good"):
        assert getattr(there, name) == pytest.approx(getattr(here, name), rel=1e-6), name


def test_evidence_does_not_change_when_the_surveys_are_swapped():
    """Two surveys of one size, each half in the other; what is left is by how the prior is spread."""
    rng = np.random.default_rng(3)
    T = turn_about(np.zeros(3), np.array([0.0, 0.0, 0.7, 0.6, 0.0, 0.0]))
    base = prepared_map(FIELD, box(rng, 300), rng, length=0.5)
    target = seen_from(prepared_map(FIELD, box(rng, 300) + np.array([0.6, 0.0, 0.0]), rng, length=0.5), T.inv())
    one, other = (weighed(*each) for each in ((base, target, T), (target, base, T.inv())))
    assert one.log_evidence > 20
    assert one.log_evidence == pytest.approx(other.log_evidence, rel=0.03)
    assert one.misfit == pytest.approx(other.misfit, rel=0.01)


def test_evidence_does_not_change_with_the_unit_of_the_field(pair):
    base, target = pair
    here = weighed(base, target)
    unit = 100.0

    def in_unit(m):
        scale = np.append(np.full(3, unit), unit)
        posterior = replace(m.posterior, constant=unit * m.posterior.constant, linear=unit * m.posterior.linear)
        raster = m.raster._replace(values=m.raster.values * np.where(m.raster.values[..., 3:] < 0, 1.0, scale))
        return replace(
            m, posterior=posterior, raster=raster, sample_field=unit * m.sample_field, noise_sd=unit * m.noise_sd
        )

    base, target = in_unit(base), in_unit(target)
    there = weighed(base, target)
    assert there.log_evidence == pytest.approx(here.log_evidence, rel=1e-6)
    assert (there.n_good, there.n_informative) == (here.n_good, here.n_informative)


def test_a_right_pose_leaves_residuals_of_size_one_and_a_wrong_one_none_that_agree(pair):
    base, target = pair
    right = weighed(base, target)
    assert right.residual == pytest.approx(np.sqrt(0.3**2 / (2 * 0.3**2 + 0.2**2)), rel=0.1)
    assert right.overlap == 1.0
    assert right.good_share == 1.0
    assert right.log_evidence > 50
    turned = turn_about(np.zeros(3), np.array([0.0, 0.0, 1.5, 0.0, 0.0, 0.0]))
    wrong = weighed(base, target, turned)
    assert wrong.log_evidence < 0
    assert wrong.misfit > 5 * right.misfit


def test_more_agreement_is_never_less_evidence(pair):
    base, target = pair
    pose, nulls = pose_at(base, target), null_models_of(base, target)
    exact = FIELD.evaluate(target.samples).field
    noise = target.sample_field - exact
    noise = noise + 1e-6 * np.sin(4 * target.samples)
    found = [
        weigh_pose(base, replace(target, sample_field=exact + s * noise), pose, nulls, PRIOR) for s in (9, 4, 2, 1, 0)
    ]
    odds = [e.log_evidence for e in found]
    assert odds == sorted(odds)
    assert [e.n_good for e in found] == sorted(e.n_good for e in found)
    misfits = [e.misfit for e in found]
    assert misfits == sorted(misfits, reverse=True)


def test_no_pose_has_more_evidence_than_is_attainable(pair):
    """Sensors that must differ included; nearly all of it where nothing is left over."""
    base, target = pair
    nulls, exact = null_models_of(base, target), FIELD.evaluate(target.samples).field
    wrong = turn_about(np.zeros(3), np.array([0.0, 0.0, 1.5, 0.0, 0.0, 0.0]))
    for T, size, mode in (
        (HERE, 0.3e-6, "scale"),
        (HERE, 20e-6, "none"),
        (wrong, 0.0, "none"),
        (wrong, 2e-6, "scale"),
    ):
        read = replace(target, sample_field=exact + size * np.sin(4 * target.samples))
        pose = pose_at(base, read, T, mode)
        if mode == "scale":
            pose = replace(pose, sensor=pose.sensor.stepped(pose.sensor_sd * [0.5, -1.0, 2.0, 1.5]))
        found = weigh_pose(base, read, pose, nulls, PRIOR)
        assert found.log_evidence <= found.attainable
    base, read = replace(base, sample_field=FIELD.evaluate(base.samples).field), replace(target, sample_field=exact)
    right = weighed(base, read)
    assert right.log_evidence == pytest.approx(right.attainable, abs=0.1)


def test_a_pose_off_the_map_has_neither_cells_nor_evidence(pair):
    base, target = pair
    found = weighed(base, target, RigidTransform.from_translation([30.0, 0, 0]))
    assert found.log_evidence == -np.inf
    assert (found.overlap, found.n_informative, found.good_share) == (0.0, 0, 0.0)


@pytest.mark.parametrize("of", ["base", "target"])
def test_positions_that_are_off_by_as_much_as_is_stated_leave_no_misfit(pair, of):
    """Each cell's positions by an error of its own: residuals that are many times the noise, and expected."""
    base, target = pair
    side, off = 0.5, 0.3
    rng, drift = np.random.default_rng(4), replace(target.drift, sd=off)
    _, cell = np.unique(np.floor(target.samples / side), axis=0, return_inverse=True)
    errors = off * rng.standard_normal((cell.max() + 1, 3))[cell]
    moved = replace(target, sample_field=FIELD.evaluate(target.samples + errors).field)
    stated = (replace(base, drift=drift), moved) if of == "base" else (base, replace(moved, drift=drift))
    silent, told = (
        weigh_pose(*both, pose_at(*pair), null_models_of(*both), PRIOR) for both in ((base, moved), stated)
    )
    assert told.misfit == pytest.approx(1.0, abs=0.25)
    assert silent.misfit > 4
    assert told.log_evidence == silent.log_evidence


def test_choosing_cells_costs_the_logarithm_of_how_many_choices_there_are(pair):
    base, target = pair
    nulls = null_models_of(base, target)
    null = nulls.target
    n = len(null.cells.counts)
    residual = 1e-8 * np.random.default_rng(7).standard_normal((n, 3))
    changed = np.random.default_rng(8).permutation(n)[: n // 3]
    residual[changed] += 20e-6
    seen = CellComparison(np.ones(1, bool), np.ones(1), np.arange(n), residual, np.zeros(n), np.zeros(n))
    rows, log_ratio, price = agreeing_cells(seen, null, (1.0, 0.7, 0.5))
    assert not set(rows) & set(changed)
    assert len(rows) in (round(0.7 * n), round(0.5 * n))
    assert price == pytest.approx(np.log(comb(n, len(rows))))
    of_them = null.log_ratio(residual[rows], np.zeros(len(rows)), rows)[0]
    assert log_ratio == pytest.approx(of_them - price)
    worst = (residual[rows] ** 2).sum(axis=1) / null.noise[rows]
    rest = np.setdiff1d(np.arange(n), rows)
    assert worst.max() <= ((residual[rest] ** 2).sum(axis=1) / null.noise[rest]).min()
    nothing = replace(seen, rows=np.zeros(0, dtype=int))
    assert agreeing_cells(nothing, null)[1] == -np.inf


def of_all(base, target, null):
    seen = compare_cells(base, target, HERE, target.sample_field, null)
    return seen.residual[seen.rows], seen.map_variance[seen.rows], seen.rows
