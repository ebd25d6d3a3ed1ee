# SPDX-License-Identifier: BSD-3-Clause
"""Evidence weighs models by all that they allow for, and is neither lost nor made when bins are forgotten."""

from dataclasses import replace

import numpy as np
import pytest

import magmatch as mm
from magmatch.localization.bins import STEP
from magmatch.localization.known_map import KnownMap
from magmatch.localization.measurement import FIT, LatestBins, follow
from magmatch.localization.state import hypotheses, model_of
from magmatch.localization.weigh_hypotheses import OutsidePenalty, covariance_of, evidence, forget, weigh

N, FREE = 24, OutsidePenalty(0.0, 0)


def fits(rng, n_models, chi2):
    """Bins of some models, all seen and known, of a mean chi^2."""
    fit = np.zeros((N, n_models), FIT)
    fit["chi2"] = chi2 / 3 * rng.chisquare(3, (N, n_models))
    fit["half_log_det"], fit["is_seen"], fit["is_known"] = 1.0, 1, 1
    return fit


def some_bins(seed, n_models=2):
    """Bins of hypotheses that explain them, and of three unrelated fields that do so less well."""
    rng = np.random.default_rng(seed)
    return LatestBins(np.zeros(N, STEP), fits(rng, n_models, 3.0), fits(rng, 3, 4.0))


def test_an_unrelated_field_that_explains_nothing_costs_the_others_its_prior_share(known):
    bins = some_bins(0)
    another = replace(bins, null=np.concatenate([bins.null, fits(np.random.default_rng(1), 1, 300.0)], axis=1))
    before, after = (evidence(some, known, FREE)[0] for some in (bins, another))
    np.testing.assert_allclose(after, before + np.log(4 / 3), atol=1e-9)


def test_unrelated_fields_that_explain_alike_count_once(known):
    bins = some_bins(1)
    twice = replace(bins, null=np.concatenate([bins.null, bins.null], axis=1))
    once, again = (evidence(some, known, FREE)[0] for some in (bins, twice))
    np.testing.assert_allclose(again, once, atol=1e-9)


def test_evidence_counts_by_the_share_of_the_fields_variance_that_a_map_explains(known):
    poor = replace(known, noise=replace(known.noise, misfit_sd=0.8 * known.field_sd, constant_sd=0.0))
    assert poor.dispersion**-2 == pytest.approx(1 - 0.8**2)
    assert known.dispersion < 1.05
    useless = replace(known, noise=replace(known.noise, misfit_sd=2 * known.field_sd))
    assert useless.dispersion == pytest.approx(np.sqrt(20))


def test_residuals_that_the_covariances_factor_explains_are_no_misfit(known):
    bins, rng = some_bins(2, 1), np.random.default_rng(3)
    rougher, odd = (replace(bins, fit=fits(rng, 1, chi2)) for chi2 in (4.0, 60.0))
    (_, usual, a), (_, large, b) = (evidence(some, known, FREE) for some in (bins, rougher))
    assert large > usual
    np.testing.assert_allclose([a, b], 1.0, atol=0.15)
    # No covariance of a factor that was ever seen explains these.
    assert evidence(odd, known, FREE)[2] > 2


def test_a_bin_that_is_forgotten_leaves_what_it_gained_up_to_a_cap(known):
    bins, bank = some_bins(3), hypotheses(2)
    # The first bin speaks for the first hypothesis, and against the second.
    bins.fit["chi2"][0], bins.null["chi2"][0] = [0.1, 60.0], 20.0
    before = evidence(bins, known, FREE)[0]
    for most in (np.inf, 1.0):
        bank["earlier"] = 0.0
        forget(bins, known, FREE._replace(most=most), bank)
        after = bank["earlier"] + evidence(bins[1:], known, FREE)[0]
        np.testing.assert_allclose(after[1], before[1], atol=1e-9)
        assert bank["earlier"][0] == pytest.approx(1.0) if most == 1.0 else after[0] == pytest.approx(before[0])


def test_who_is_trusted_and_outside_the_map_forgets_nothing(known):
    bins, bank = some_bins(4), hypotheses(2)
    bins.fit["chi2"][0], bins.null["chi2"][0], bins.fit["is_known"][-1] = 0.1, 20.0, 0
    forget(bins, known, OutsidePenalty(0.0, 1, 1.0), bank)
    assert bank["earlier"][0] > 5
    assert bank["earlier"][1] == pytest.approx(1.0)


def test_a_pose_of_worse_readings_is_known_as_a_filter_of_such_readings_knows_it(place, known, followed, feed):
    """Odometry is as good as before: four times the readings' covariance doubles the pose's."""
    log, localizer = followed.log, mm.Localizer(place)
    feed(localizer, log, slice(0, 60))
    belief, usual = localizer._maps.best, model_of(known, mm.LocalizerConfig())
    worse = {k: 4 * getattr(usual, k) for k in ("misfit_variance", "map_factor2", "nugget_variance")}
    a, b = (belief._bank[:1].copy() for _ in range(2))
    sizes = []
    for n in range(60, len(log)):
        steps = belief._window.steps
        feed(localizer, log, slice(n, n + 1))
        if belief._window.steps is steps:
            continue
        for one, model in ((a, usual), (b, usual._replace(**worse))):
            follow(one, known, model, belief._window.steps[-1:], np.zeros((1, 1), FIT), moves_first=True)
        sizes.append([np.trace(one["P"][0, 3:6, 3:6]) for one in (a, b)])
    ratio = np.median([y / x for x, y in sizes[len(sizes) // 4 :]])
    assert ratio == pytest.approx(2.0, rel=0.25)
    said = [np.trace((covariance_of(a, known, factor) - known.bent)[3:, 3:]) for factor in (1.0, 4.0)]
    assert said[1] / said[0] == pytest.approx(ratio, rel=0.25)


def test_a_way_outside_the_map_costs_no_more_than_coming_into_it(known):
    bins = some_bins(5, 1)
    bins.steps["u"][:, 0], bins.fit["is_known"][: N // 2] = 1.0, 0
    tolls = FREE, OutsidePenalty(0.1, 0, 5.0), OutsidePenalty(3.0, 0, 5.0)
    inside, *usual = (evidence(bins, known, toll)[0] for toll in tolls)
    np.testing.assert_allclose(inside - usual, [[0.1 * N / 2], [5.0]], atol=1e-9)


def test_a_pose_under_several_drifts_is_one_answer_with_the_evidence_of_all(known):
    bins, bank = some_bins(8, 4), hypotheses(4)
    bank["drift"], bank["p"][3] = [1.0, 7.0, 7.0, 1.0], 5.0
    gained = evidence(bins, known, FREE)[0]
    (one, other) = sorted(weigh(bank, bins, known, FREE, (0.1, 0.1)), key=lambda w: -len(w.rows))
    kept = [0, 1 + int(gained[2] > gained[1])]
    assert sorted(one.rows) == kept
    assert one.log_evidence == pytest.approx(np.logaddexp.reduce(gained[kept]))
    assert other.rows == (3,)


def test_of_several_drifts_the_likeliest_is_capped_and_the_others_stay_behind(known):
    bins, bank = some_bins(10, 1), hypotheses(3)
    bank["earlier"] = [7.0, 9.0, 1.0]
    forget(replace(bins, fit=np.repeat(bins.fit, 3, axis=1)), known, OutsidePenalty(0.0, 3, 4.0), bank)
    np.testing.assert_allclose(bank["earlier"] - bank["earlier"][1], [-2.0, 0.0, -4.0], atol=1e-9)


def test_a_pose_is_known_no_better_than_the_maps_own_positions_are_stated_to_be(place, known):
    for pose_sd, least in ((1.5, 1.5), (0.001, known.noise.drift_sd)):
        survey = replace(place.field_map.survey, pose_sd=pose_sd)
        base = replace(place.base, field_map=replace(place.field_map, survey=survey))
        stated = KnownMap.of(replace(place, base=base))
        exact = hypotheses(1)
        exact["P"] = 0.0
        np.testing.assert_allclose(covariance_of(exact, stated, 1.0)[3:, 3:], least**2 * np.eye(3), atol=1e-12)
