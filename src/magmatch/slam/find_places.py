# SPDX-License-Identifier: BSD-3-Clause
"""The method on one page: hyperparameters that logs share, windows, rounds of search for closures, a last look."""

import logging
from collections.abc import Sequence

import numpy as np

from magmatch.data.checks import extent
from magmatch.data.diagnoses import CONSTANT_FIELD
from magmatch.data.survey import Survey
from magmatch.progress import tell
from magmatch.registration.clock import Clock
from magmatch.registration.prepared.path_noise import PRIOR_STRETCHES
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor
from magmatch.slam.graph.odometry import lie_level, odometry_graph
from magmatch.slam.graph.solve import forget_closures
from magmatch.slam.places import Places
from magmatch.slam.refine.refine import refine
from magmatch.slam.search.bases import BaseMaker, Run
from magmatch.slam.search.predicted import SURE
from magmatch.slam.sensor_bias import in_one_calibration, sensor_bias, without_bias
from magmatch.slam.shared_numbers import N_PARTS, guessed_noise, shared_numbers
from magmatch.slam.steps import Steps
from magmatch.slam.windows import cut
from magmatch.threads import one_blas_thread

log = logging.getLogger(__name__)

# Closures that noise is learned from before the search proper: a tenth is left to what was guessed.
ENOUGH = 9 * PRIOR_STRETCHES
NO_BIAS = (np.zeros(3), np.zeros(3))


def settled(given: Sequence[Survey], config: SlamConfig) -> SlamConfig:
    """Settings with what the logs show of themselves: whether they lie level."""
    is_level = lie_level(given)
    if config.is_planar and not is_level:
        z = np.concatenate([survey.positions[:, 2] for survey in given])
        log.warning(
            "stated as planar, but heights go from %.2f to %.2f m, or bodies lean: unstated, both are estimated",
            z.min(), z.max(),
        )  # fmt: skip
    if not config.is_gravity_aligned or config.is_planar or not is_level:
        return config
    log.info("all poses lie at one height: taken as planar")
    return config.model_copy(update={"is_planar": True})


def begin(given: Sequence[Survey], config: SlamConfig, n_parts: int = N_PARTS) -> Places:
    """Logs cut into windows, as odometry has them, and numbers of the field, from so many parts."""
    if all(survey.field.std(axis=0).max() < CONSTANT_FIELD for survey in given):
        # Nothing tells places apart, and the field has no length.
        paths = cut(given, max(float(extent(survey).max()) for survey in given), config)
        return Places(paths, odometry_graph(paths, config), config, None, [NO_BIAS] * len(given))
    tell("learning how the field changes")
    given = [in_one_calibration(survey) for survey in given]
    numbers, length, measured = shared_numbers(given, n_parts)
    biases = [sensor_bias(survey, numbers, config) for survey in given]
    paths = cut([without_bias(survey, bias) for survey, (bias, _) in zip(given, biases, strict=True)], length, config)
    n_windows, walked = sum(len(p.windows) for p in paths), config.window_length * length
    log.info("field length %.2f m; %d windows of %.1f m", length, n_windows, walked)
    maker = BaseMaker(numbers, measured, guessed_noise(numbers, length), length, config)
    return Places(paths, odometry_graph(paths, config), config, maker, biases)


def find(
    given: Sequence[Survey],
    config: SlamConfig,
    anchors: list[tuple[Anchor, int]],
    steps: Steps,
    run: Run | None,
    clock: Clock,
) -> Places:
    """All logs at once: the noise is learned from the most certain closures; then all are searched again with it."""
    with one_blas_thread():
        with clock("numbers"):
            places = begin(given, config)
        places.steps, places.anchors = steps, anchors
        places.solve()
        if places.maker is not None:
            places.maker.run = run
            with clock("noise"):
                places.close_near(places.paths, ENOUGH, SURE)
                places.learn_noise()
                forget_closures(places.graph)
            with clock("closures"):
                places.close(places.paths)
            with clock("refinement"):
                refine(places, places.paths)
    return places


def go_on(
    earlier: Places,
    logs: Sequence[Survey],
    anchors: Sequence[tuple[Anchor, int]],
    steps: Steps,
    run: Run | None,
    clock: Clock,
) -> Places:
    """Add logs with the known hyperparameters; closures between earlier logs are kept."""
    places = earlier.copied()
    places.steps, places.anchors = steps, [*places.anchors, *anchors]
    assert places.maker is not None
    places.maker.run = run
    with one_blas_thread():
        with clock("closures"):
            places.solve()
            for survey in logs:
                if places.graph.config.is_planar and not lie_level([survey]):
                    log.warning("%s: does not lie level, and is taken as planar like the logs before it", survey.name)
                places.close([places.add(survey)])
        with clock("refinement"):
            refine(places, places.paths[len(earlier.paths) :])
    return places
