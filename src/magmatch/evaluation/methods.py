# SPDX-License-Identifier: BSD-3-Clause
"""The methods that are compared."""

from magmatch.baselines.hov_kiss import KissConfig, register_by_kiss_matcher
from magmatch.baselines.local_refinement import GicpConfig, register_by_gicp, register_by_refinement
from magmatch.baselines.sift_layers import SiftConfig, register_by_sift
from magmatch.evaluation.method import Baseline, Method, Preset, Refiner
from magmatch.evaluation.trial import ROUGH_WORDS
from magmatch.field.config import FieldConfig
from magmatch.registration.config import PRESETS

PAPER = PRESETS["paper"]
PUBLISHED_FIELD, OUR_FIELD = PAPER.field, FieldConfig()

METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Preset("default", "this package's method", PRESETS["default"]),
        Preset("paper", "the published method (Mag-Match), corrections of docs/theory/published.md", PAPER),
        Baseline(
            "sift", "SIFT on horizontal layers of |B|, as published",
            PUBLISHED_FIELD, SiftConfig(), register_by_sift, "cv2",
        ),
        Baseline(
            "sift-best", "SIFT on layers in 31 directions, of this package's maps",
            OUR_FIELD, SiftConfig(directions="many", layer_gap=3.0, max_layers=12), register_by_sift, "cv2",
        ),
        Baseline(
            "kiss", "KISS-Matcher's solver on the published keypoints",
            PUBLISHED_FIELD, KissConfig(), register_by_kiss_matcher, "kiss_matcher",
        ),
        Refiner(
            "gicp", f"GICP on surfaces of equal |B|, {ROUGH_WORDS}",
            OUR_FIELD, GicpConfig(), register_by_gicp, True, "small_gicp",
        ),
        Refiner(
            "refine-rough", f"this package's refinement alone, {ROUGH_WORDS}",
            OUR_FIELD, PRESETS["default"], register_by_refinement, True,
        ),
        Refiner(
            "refine-identity", "this package's refinement alone, from the identity",
            OUR_FIELD, PRESETS["default"], register_by_refinement, False,
        ),
    )
}  # fmt: skip
