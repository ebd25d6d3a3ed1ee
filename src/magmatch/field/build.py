# SPDX-License-Identifier: BSD-3-Clause
"""`build_map`: samples in, field map out."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

from magmatch.arguments import expect_kind, found
from magmatch.data.checks import require_one_frame, require_part, require_survey
from magmatch.data.survey import Survey, subsets
from magmatch.errors import SurveyError
from magmatch.field.choose_and_fit import choose_and_fit, choose_biases
from magmatch.field.config import FieldConfig
from magmatch.field.excess import warn_of_excess
from magmatch.field.map import FieldMap
from magmatch.field.selection.outliers import find_outliers, hardly_moved
from magmatch.progress import Progress, followed
from magmatch.runner import Workers
from magmatch.threads import single_threaded

log = logging.getLogger(__name__)


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
        Samples; several surveys must share one frame and are mapped together. Where their orientations are known,
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
    biases = choose_biases(surveys, config, run)
    if biases is not None:
        surveys = biases.without(surveys)
    field_map, unbounded, samples = choose_and_fit(surveys, config, run)
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
    fitted = choose_and_fit(subsets(surveys, ~is_out), field_map.config, run)[0]
    return replace(fitted, biases=biases and biases.subset(surveys, ~is_out))


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
