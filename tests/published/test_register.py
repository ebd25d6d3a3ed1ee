# SPDX-License-Identifier: BSD-3-Clause
"""The published method as a whole, on maps made from samples, and with parts of one's own."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from exact_maps import room_of_dipoles, survey_in
from magmatch.features.config import FeatureConfig
from magmatch.features.infer import grid_spacing
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.geometry import random_transform, transform_error
from magmatch.published import Matches, PublishedConfig, comparable, infer, register
from magmatch.registration.config import PRESETS

CONFIG = PublishedConfig()
BOX = np.array([3.0, 3.0, 0.6])
T_BASE_TARGET = random_transform(np.random.default_rng(11))
FIELD = FieldConfig(prior="divergence_free", lengthscale=0.6, signal_sd=2e-5, noise_sd=0.6e-6, spacing=0.45)


def survey_of(room, seed, T_world_survey, n=700):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, BOX, (n, 3))
    noise = 0.5e-6 * rng.standard_normal((n, 3))
    return survey_in(room_of_dipoles(room, BOX), x, T_world_survey, noise)


@pytest.fixture(scope="module")
def base_map():
    return build_map(survey_of(2, 1, RigidTransform.identity()), FIELD)


@pytest.fixture(scope="module")
def target_map():
    return build_map(survey_of(2, 2, T_BASE_TARGET), FIELD)


def test_the_published_method_finds_a_random_transform(base_map, target_map):
    T = T_BASE_TARGET
    found = register(base_map, target_map)
    assert found.is_accepted
    distance, angle = transform_error(found.T_base_target, T, target_map.survey.centroid)
    assert distance < 0.06
    assert np.degrees(angle) < 2
    assert found.check.value < 0.05
    n_keypoints = len(found.base) + len(found.target)
    assert 50 < found.inliers.sum() <= len(found.matches) < n_keypoints
    p_base = found.base.positions[found.matches.base_rows[found.inliers]]
    p_target = found.target.positions[found.matches.target_rows[found.inliers]]
    assert np.all(np.linalg.norm(found.T_base_target.apply(p_target) - p_base, axis=1) < 0.3)
    assert len(repr(found).splitlines()) <= 3


def test_to_the_letter_the_method_finds_it_too(base_map, target_map):
    found = register(base_map, target_map, config=PRESETS["paper-literal"].keypoints)
    assert found.is_accepted
    distance, angle = transform_error(found.T_base_target, T_BASE_TARGET, target_map.survey.centroid)
    assert distance < 0.06
    assert np.degrees(angle) < 3
    assert found.config.features.component_range == 0.01


def test_nothing_in_common_is_a_result(base_map):
    nothing = CONFIG.model_copy(update={"features": FeatureConfig(min_frame_strength=0.999)})
    found = register(base_map, base_map, config=nothing)
    assert found.candidates == ()
    assert found.check is found.T_base_target is None
    assert len(found.inliers) == len(found.matches) == 0


def test_both_maps_are_asked_at_one_spacing_and_over_one_range(base_map):
    finer = build_map(
        survey_of(2, 4, RigidTransform.identity(), n=200),
        FIELD.model_copy(update={"lengthscale": 0.4, "spacing": 0.6}),
    )
    shared = comparable(base_map, finer, CONFIG)
    assert shared.features.spacing == grid_spacing(base_map, FeatureConfig()) > grid_spacing(finer, FeatureConfig())
    assert comparable(finer, base_map, CONFIG) == shared


def test_a_detector_a_descriptor_and_a_matcher_of_ones_own_are_used(base_map, target_map):
    """Every fifth point is a keypoint, known by the strength of its field; all match the first one of the base."""

    def detector(inferred):
        return np.arange(0, len(inferred), 5)

    def descriptor(inferred, frames):
        return np.linalg.norm(inferred.field[frames.rows], axis=1)[:, None]

    def matcher(base, target):
        assert base.shape[1] == target.shape[1] == 1
        rows = np.arange(len(target))
        return Matches(0 * rows, rows, np.zeros(len(rows)))

    found = register(base_map, target_map, detector=detector, descriptor=descriptor, matcher=matcher)
    assert len(found.target) == len(found.matches)
    np.testing.assert_allclose(found.base.descriptors[:, 0], np.linalg.norm(found.base.field, axis=1))
    assert not found.candidates


def test_the_steps_on_the_page_are_those_of_register(base_map, target_map):
    page = (Path(__file__).parents[2] / "docs" / "theory" / "published.md").read_text("utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    # Its maps are those here, so that they need not be made again.
    code = re.sub("maps = .*", "maps = [base_map, target_map]", code)
    names = {"base_map": base_map, "target_map": target_map, "target": target_map.survey}
    exec(code, names)
    whole = register(base_map, target_map)
    np.testing.assert_array_equal(names["matches"].base_rows, whole.matches.base_rows)
    np.testing.assert_array_equal(
        names["found"][0].T_base_target.as_matrix(), whole.candidates[0].T_base_target.as_matrix()
    )
    assert names["check"] == whole.check


PARTS = {
    "rows that X* does not have": ({"detector": lambda at: [len(at)]}, ValueError, "rows"),
    "rows of floats": ({"detector": lambda at: np.linspace(0, 1, len(at))}, ValueError, "rows"),
    "too few descriptors": (
        {"descriptor": lambda at, frames: np.ones((len(frames) - 1, 3))},
        ValueError,
        "one finite",
    ),
    "one number each": ({"descriptor": lambda at, frames: np.ones(len(frames))}, ValueError, "got shape"),
    "a NaN": ({"descriptor": lambda at, frames: np.full((len(frames), 3), np.nan)}, ValueError, "not finite"),
    "a pair of rows": ({"matcher": lambda base, target: (np.arange(3), np.arange(3))}, TypeError, "Matches"),
}


@pytest.mark.parametrize("what", PARTS)
def test_a_part_that_returns_something_else_than_its_protocol_says_is_named(base_map, what):
    parts, kind, said = PARTS[what]
    with pytest.raises(kind, match=said):
        register(base_map, base_map, **parts)


def test_a_detector_may_say_which_rows_by_a_mask(base_map):
    rows = np.arange(0, len(infer(base_map)), 7)
    mask = np.isin(np.arange(len(infer(base_map))), rows)
    by_rows, by_mask = (register(base_map, base_map, detector=lambda at, one=one: one) for one in (rows, mask))
    np.testing.assert_array_equal(by_rows.base.positions, by_mask.base.positions)
