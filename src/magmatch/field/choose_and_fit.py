# SPDX-License-Identifier: BSD-3-Clause
"""One map of given samples: its prior and hyperparameters are chosen, then it is fitted."""

from collections.abc import Sequence

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.choose_prior import PREFERRED, choose_numbers, choose_prior
from magmatch.field.config import FieldConfig
from magmatch.field.domain import Box
from magmatch.field.fit import fit_unbounded, within
from magmatch.field.linear_model import FieldPosterior
from magmatch.field.map import FieldMap
from magmatch.field.priors import prior_over
from magmatch.field.sensor_biases import SensorBiases, biased_logs, no_biases, shared_errors, solve_biases
from magmatch.progress import tell
from magmatch.runner import Workers

# Biases and the field's numbers are chosen in turn, since numbers that take biases for noise leave some of them:
# until biases move by less than this share of their sd, which is less than they are known to, or so often.
SETTLED, MOST_BIAS_ROUNDS = 0.2, 6


def choose_biases(surveys: Sequence[Survey], config: FieldConfig, run: Workers | None) -> SensorBiases | None:
    """Biases of the logs' sensors, solved with the field; None for one survey alone, or where there are none."""
    if len(surveys) < 2 or not biased_logs(surveys) or config.sensor_bias_sd == 0:
        return None
    if config.prior != PREFERRED:
        # It costs least, and priors are compared without biases. Numbers that are given are another prior's.
        config = FieldConfig(prior=PREFERRED, domain=config.domain, sensor_bias_sd=config.sensor_bias_sd)
    merged, biases = surveys[0].merged(*surveys[1:]), no_biases(len(surveys))
    for _ in range(MOST_BIAS_ROUNDS):
        field_map, posterior, samples = choose_and_fit(biases.without(surveys), config, run)
        T_model_map = field_map.T_map_model.inv()
        measured, before = merged.transformed(T_model_map), biases.bias
        n_alike = shared_errors(posterior, samples)
        biases = solve_biases(
            posterior, T_model_map.rotation, measured, surveys, config.sensor_bias_sd, n_alike=n_alike
        )
        if np.linalg.norm(biases.bias - before) <= SETTLED * np.linalg.norm(biases.sd):
            break
    return biases if biases.spread > 0 else None


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
