# SPDX-License-Identifier: BSD-3-Clause
"""The verb of this room: samples in, field map out."""

import logging
from collections.abc import Sequence

import numpy as np

from magmatch.data.survey import Survey, subsets
from magmatch.field.comparison import choose_prior, resolved_hyperparameters
from magmatch.field.config import FieldConfig
from magmatch.field.domain import BoundedPosterior
from magmatch.field.fit import check_finite, fit_posterior
from magmatch.field.map import FieldMap
from magmatch.field.selection.outliers import find_outliers
from magmatch.field.tiles.tiled_model import Runner
from magmatch.threads import single_threaded
from magmatch.typing import Mask

log = logging.getLogger(__name__)

# Samples left out that had less than this share of the squared residuals did not shape the numbers either.
LITTLE_POWER = 0.2


@single_threaded
def build_map(survey: Survey | Sequence[Survey], config: FieldConfig | None = None, run: Runner = map) -> FieldMap:
    """Infer the magnetic field of a place from a survey.

    Parameters
    ----------
    survey : Survey or sequence of Survey
        Samples; several surveys must share one frame and are merged.
    config : FieldConfig, optional
        Prior and hyperparameters; what is left out is chosen from the data.
    run : callable, optional
        Runs the tasks of a map in tiles, such as `magmatch.field.tiles.distributed.DaskRunner`; one after the other
        here by default. The map is the same to the bit.

    Returns
    -------
    FieldMap
        Posterior of the field, in the survey's frame.

    Raises
    ------
    SurveyError
        If the survey holds NaN, impossible values or too few samples.
    """
    config = config or FieldConfig()
    surveys = (survey,) if isinstance(survey, Survey) else tuple(survey)
    field_map = _fitted(surveys, config, run)
    if not config.leave_out_outliers:
        return field_map
    assert field_map.fitted_samples is not None  # a map that was just made holds them
    # Samples outside of a declared box inform what lies inside, and are judged like all others.
    posterior = field_map.posterior
    unbounded = posterior.inner if isinstance(posterior, BoundedPosterior) else posterior
    is_out = find_outliers(field_map.fitted_samples, unbounded)
    if not is_out.any():
        return field_map
    log.warning(
        "%s: %d of %d samples contradict those around them (a phone that rang, metal that passed?) and are left out",
        field_map.survey.name, is_out.sum(), len(is_out),
    )  # fmt: skip
    if _power_share(field_map, is_out) < LITTLE_POWER:
        # What hardly moved the fit hardly moved the numbers it was fitted with, nor the tiles that did not see it.
        return field_map.without_samples(is_out, run)
    return _fitted(subsets(surveys, ~is_out), config, run)


def _power_share(field_map: FieldMap, rows: Mask) -> float:
    """Share of the squared residuals that some samples have."""
    samples = field_map.fitted_samples
    assert samples is not None  # a map that was just made holds them
    power = ((samples.field - field_map.posterior.evaluate(samples.positions).field) ** 2).sum(axis=1)
    return float(power[rows].sum() / max(power.sum(), np.finfo(float).tiny))


def _fitted(surveys: tuple[Survey, ...], config: FieldConfig, run: Runner) -> FieldMap:
    """Map of all samples of some surveys, with numbers chosen where none are given."""
    merged = surveys[0].merged(*surveys[1:])
    check_finite(merged)
    T_map_model = merged.principal_frame()
    samples = merged.transformed(T_map_model.inv())
    if config.prior == "auto":
        config, hyperparameters = choose_prior(samples, config, T_map_model)
    else:
        hyperparameters = resolved_hyperparameters(samples, config, T_map_model)
    log.info("fitting the field of %s (%d samples, prior %s)", merged.name, len(merged), config.prior)
    posterior = fit_posterior(samples, hyperparameters, config, T_map_model, run=run)
    return FieldMap(merged, posterior, T_map_model, config, T_map_model, samples, surveys if len(surveys) > 1 else ())
