# SPDX-License-Identifier: BSD-3-Clause
"""`build_map`: samples in, field map out."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from magmatch.arguments import expect_kind, found
from magmatch.data.checks import require_one_frame, require_part, require_survey
from magmatch.data.survey import Survey, subsets
from magmatch.errors import SurveyError
from magmatch.field.choose_prior import PREFERRED, choose_numbers, choose_prior
from magmatch.field.config import FieldConfig
from magmatch.field.domain import Box
from magmatch.field.excess import warn_of_excess
from magmatch.field.fit import fit_unbounded, within
from magmatch.field.linear_model import FieldPosterior
from magmatch.field.map import FieldMap
from magmatch.field.priors import prior_over
from magmatch.field.selection.outliers import find_outliers, hardly_moved
from magmatch.field.sensor_biases import SensorBiases, biased_logs, no_biases, shared_errors, solve_biases
from magmatch.progress import Progress, followed, tell
from magmatch.runner import Workers
from magmatch.threads import single_threaded

log = logging.getLogger(__name__)

# Biases and the field's numbers are chosen in turn, since numbers that take biases for noise leave some of them:
# until biases move by less than this share of their sd, or of the noise, which numbers do not feel; or so often.
SETTLED, MOST_BIAS_ROUNDS = 0.2, 6
# A map of all samples, its posterior without a declared box, and the samples in the model's frame.
Fitted = tuple[FieldMap, FieldPosterior, Survey]


@single_threaded
def build_map(
    survey: Survey | Sequence[Survey],
    config: FieldConfig | None = None,
    run: Workers | None = None,
    *,
    progress: Progress | None = None,
) -> FieldMap:
    """Infer the magnetic field of a place from a survey.

    Parameters
    ----------
    survey : Survey or sequence of Survey
        Samples; several surveys must share one frame and are mapped together. Along a path, or with orientations,
        each one's sensor bias is solved with the field and taken out (`FieldMap.biases`).
    config : FieldConfig, optional
        Prior and hyperparameters; those not given are chosen from the data.
    run : callable, optional
        Runs the tasks of a tiled map, such as `magmatch.DaskRunner`; by default sequentially,
        in this process. The map is the same bit for bit.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.

    Returns
    -------
    FieldMap
        Posterior of the field, in the survey's frame.

    Raises
    ------
    SurveyError
        If the survey holds NaN, impossible values or too few samples.
    """
    config = FieldConfig() if config is None else config
    expect_kind(config, "config", (FieldConfig,), "FieldConfig(prior=...) makes one")
    with followed(progress):
        built = map_samples(surveys_of(survey), config, run)
    warn_of_excess(built, built.survey)
    return built


def map_samples(surveys: tuple[Survey, ...], config: FieldConfig, run: Workers | None = None) -> FieldMap:
    """Map of samples without checking them, however few or suspicious."""
    biases, fitted = choose_biases(surveys, config, run)
    if biases is not None:
        log.info("%s", biases.in_words)
        surveys = biases.without(surveys)
    if fitted is None or config.prior != PREFERRED:
        fitted = choose_and_fit(surveys, config, run, fitted)
    field_map, unbounded, samples = fitted
    field_map = replace(field_map, biases=biases)
    if not config.leave_out_outliers:
        return field_map
    # Samples outside of a declared box inform what lies inside, and are judged like all others.
    is_out = find_outliers(samples, unbounded)
    if not is_out.any():
        return field_map
    log.warning(
        "%s: %d of %d samples contradict their neighbours (a ringing phone, passing metal?) and are left out",
        field_map.survey.name, is_out.sum(), len(is_out),
    )  # fmt: skip
    if hardly_moved(samples, field_map.posterior, is_out):
        # Nor did they move the numbers, nor the tiles that did not see them.
        return field_map.without_samples(is_out, run)
    # The prior stays; its numbers were those of the samples left out, too.
    fewer = choose_and_fit(subsets(surveys, ~is_out), field_map.config, run)[0]
    return replace(fewer, biases=biases and biases.subset(surveys, ~is_out))


def choose_biases(
    surveys: tuple[Survey, ...], config: FieldConfig, run: Workers | None
) -> tuple[SensorBiases | None, Fitted | None]:
    """Biases of the logs' sensors and a spline's fit without them, solved in turn; None where there are none."""
    if config.sensor_bias_sd == 0 or not (logs := biased_logs(surveys)):
        return None, None
    # The spline costs least, and priors are compared without biases. Numbers that are given are another prior's.
    spline = config
    if config.prior != PREFERRED:
        spline = FieldConfig(prior=PREFERRED, domain=config.domain, sensor_bias_sd=config.sensor_bias_sd)
    merged, biases = surveys[0].merged(*surveys[1:]), no_biases(len(surveys))
    for _ in range(MOST_BIAS_ROUNDS):
        fitted = choose_and_fit(biases.without(surveys), spline, run)
        field_map, posterior, samples = fitted
        T_model_map = field_map.T_map_model.inv()
        measured, n_alike = merged.transformed(T_model_map), shared_errors(posterior, samples)
        found = solve_biases(posterior, T_model_map.rotation, measured, surveys, logs, config.sensor_bias_sd, n_alike)
        little = SETTLED * np.maximum(found.sd, posterior.hyperparameters.noise_sd)
        if (np.abs(found.bias - biases.bias) <= little).all():
            biases = replace(found, bias=biases.bias)
            break
        biases = found
    else:
        fitted = choose_and_fit(biases.without(surveys), spline, run)
    if biases.spread > 0:
        return biases, fitted
    # Biases that are none after all may have been taken out before.
    return None, None if biases.bias.any() else fitted


def choose_and_fit(
    surveys: tuple[Survey, ...], config: FieldConfig, run: Workers | None, preferred: Fitted | None = None
) -> Fitted:
    """Choose the prior and its numbers, and fit the field; see `choose_prior`.

    ``preferred``: the preferred prior's fit of the same samples, where there is one.
    """
    merged = surveys[0].merged(*surveys[1:])
    T_map_model = merged.principal_frame()
    samples, box = merged.transformed(T_map_model.inv()), Box.declared(config.domain, T_map_model)
    if config.prior == "auto":
        known = preferred and preferred[1].hyperparameters
        config, hyperparameters = choose_prior(samples, config, T_map_model, known)
    else:
        hyperparameters = choose_numbers(prior_over(config.prior, box), samples, config)
    tell(f"fitting the field of {merged.name} ({len(merged)} samples, prior {config.prior})")
    if preferred and config.prior == PREFERRED and hyperparameters == preferred[1].hyperparameters:
        unbounded = preferred[1]
    else:
        unbounded = fit_unbounded(samples, hyperparameters, prior_over(config.prior, box), {}, run)
    posterior, parts = within(box, unbounded), surveys if len(surveys) > 1 else ()
    return FieldMap(merged, posterior, T_map_model, config, T_map_model, samples, parts), unbounded, samples


def surveys_of(given: Survey | Sequence[Survey]) -> tuple[Survey, ...]:
    """Checked: each part and all together can be a survey."""
    if not isinstance(given, list | tuple):
        require_survey(given)
        return (cast("Survey", given),)
    if not given:
        msg = f"survey: expected a Survey or several, got {found(given)} without any; read_survey reads one"
        raise SurveyError(msg)
    for part in given:
        require_part(part)
    require_one_frame(given)
    require_survey(given[0].merged(*given[1:]))
    return tuple(given)
