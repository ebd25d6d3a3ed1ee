# SPDX-License-Identifier: BSD-3-Clause
"""`build_map`: samples in, field map out."""

import logging
from collections.abc import Sequence
from typing import cast

from magmatch.arguments import expect_kind, found
from magmatch.data.checks import require_part, require_survey
from magmatch.data.survey import Survey, subsets
from magmatch.errors import SurveyError
from magmatch.field.config import FieldConfig
from magmatch.field.domain import Box
from magmatch.field.fit import fit_unbounded, within
from magmatch.field.linear_model import Posterior, Runner
from magmatch.field.map import FieldMap
from magmatch.field.prior_choice.choose_prior import choose_prior
from magmatch.field.prior_choice.numbers import choose_numbers
from magmatch.field.priors import prior_over
from magmatch.field.selection.outliers import find_outliers, hardly_moved
from magmatch.progress import Progress, followed, tell
from magmatch.threads import single_threaded

log = logging.getLogger(__name__)


@single_threaded
def build_map(
    survey: Survey | Sequence[Survey],
    config: FieldConfig | None = None,
    run: Runner = map,
    *,
    progress: Progress | None = None,
) -> FieldMap:
    """Infer the magnetic field of a place from a survey.

    Parameters
    ----------
    survey : Survey or sequence of Survey
        Samples; several surveys must share one frame and are mapped together.
    config : FieldConfig, optional
        Prior and hyperparameters; those not given are chosen from the data.
    run : callable, optional
        Runs the tasks of a tiled map, such as `magmatch.field.tiles.distributed.DaskRunner`; by default sequentially,
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
        return map_samples(_surveys(survey), config, run)


def map_samples(surveys: tuple[Survey, ...], config: FieldConfig, run: Runner = map) -> FieldMap:
    """Map of samples without checking them, however few or suspicious."""
    field_map, unbounded, samples = _choose_and_fit(surveys, config, run)
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
    return _choose_and_fit(subsets(surveys, ~is_out), field_map.config, run)[0]


def _surveys(given: Survey | Sequence[Survey]) -> tuple[Survey, ...]:
    """What a map is to be made of; each part and all together can be a survey."""
    if not isinstance(given, list | tuple):
        require_survey(given)
        return (cast("Survey", given),)
    if not given:
        msg = f"survey: expected a Survey or several, got {found(given)} without any; read_survey reads one"
        raise SurveyError(msg)
    for part in given:
        require_part(part)
    require_survey(given[0].merged(*given[1:]))
    return tuple(given)


def _choose_and_fit(
    surveys: tuple[Survey, ...], config: FieldConfig, run: Runner
) -> tuple[FieldMap, Posterior, Survey]:
    """Map of all samples, its posterior without a declared box, and the samples in the model's frame."""
    merged = surveys[0].merged(*surveys[1:])
    T_map_model = merged.principal_frame()
    samples, box = merged.transformed(T_map_model.inv()), Box.declared(config.domain, T_map_model)
    if config.prior == "auto":
        config, hyperparameters = choose_prior(samples, config, T_map_model)
    else:
        hyperparameters = choose_numbers(prior_over(config.prior, box), samples, config)
    tell(f"fitting the field of {merged.name} ({len(merged)} samples, prior {config.prior})")
    unbounded = fit_unbounded(samples, hyperparameters, prior_over(config.prior, box), {}, run)
    posterior, parts = within(box, unbounded), surveys if len(surveys) > 1 else ()
    return FieldMap(merged, posterior, T_map_model, config, T_map_model, samples, parts), unbounded, samples
