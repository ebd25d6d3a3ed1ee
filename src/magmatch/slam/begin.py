# SPDX-License-Identifier: BSD-3-Clause
"""The beginning: how the field changes along the logs, their sensors' biases, and their windows."""

import logging
from collections.abc import Sequence

import numpy as np

from magmatch.data.checks import extent
from magmatch.data.sensor_axes import RESOLVED
from magmatch.data.survey import Survey
from magmatch.field.sensor_biases import without_bias
from magmatch.preparation.odometry.drift import lie_level
from magmatch.progress import tell
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor
from magmatch.slam.graph.odometry import odometry_graph
from magmatch.slam.places import Places
from magmatch.slam.search.submaps import SubmapMaker
from magmatch.slam.sensor_bias import in_one_calibration, sensor_bias
from magmatch.slam.shared_hyperparameters import N_PARTS, guessed_noise, shared_hyperparameters
from magmatch.slam.windows import cut

log = logging.getLogger(__name__)

NO_BIAS = (np.zeros(3), np.zeros(3))


def settled(given: Sequence[Survey], config: SlamConfig) -> SlamConfig:
    """Complete the settings with what the logs show of themselves: whether they lie level."""
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


def begin(
    given: Sequence[Survey], config: SlamConfig, anchors: Sequence[tuple[Anchor, int]] = (), n_parts: int = N_PARTS
) -> Places:
    """Cut logs into windows, where odometry has them; the field's length is learned from so many parts."""
    if all(survey.field.std(axis=0).max() < RESOLVED for survey in given):
        # Nothing tells places apart, and the field has no length.
        paths = cut(given, max(float(extent(survey).max()) for survey in given), config)
        return _solved(Places(paths, odometry_graph(paths, config), config, None, [NO_BIAS] * len(given), [*anchors]))
    tell("learning how the field changes")
    given = [in_one_calibration(survey) for survey in given]
    hyperparameters, length, measured = shared_hyperparameters(given, n_parts)
    biases = [sensor_bias(survey, hyperparameters, config) for survey in given]
    paths = cut([without_bias(survey, bias) for survey, (bias, _) in zip(given, biases, strict=True)], length, config)
    n_windows, walked = sum(len(p.windows) for p in paths), config.window_length * length
    log.info("field length %.2f m; %d windows of %.1f m", length, n_windows, walked)
    maker = SubmapMaker(hyperparameters, measured, guessed_noise(hyperparameters, length), length, config)
    return _solved(Places(paths, odometry_graph(paths, config), config, maker, biases, [*anchors]))


def _solved(places: Places) -> Places:
    places.solve()
    return places
