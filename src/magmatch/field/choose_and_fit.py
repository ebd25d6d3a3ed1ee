# SPDX-License-Identifier: BSD-3-Clause
"""One map of given samples: its prior and hyperparameters are chosen, then it is fitted."""

from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.domain import Box
from magmatch.field.fit import fit_unbounded, within
from magmatch.field.linear_model import FieldPosterior
from magmatch.field.map import FieldMap
from magmatch.field.prior_choice.choose_hyperparameters import choose_numbers
from magmatch.field.prior_choice.choose_prior import choose_prior
from magmatch.field.priors import prior_over
from magmatch.progress import tell
from magmatch.runner import Workers


def choose_and_fit(
    surveys: tuple[Survey, ...], config: FieldConfig, run: Workers | None
) -> tuple[FieldMap, FieldPosterior, Survey]:
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
