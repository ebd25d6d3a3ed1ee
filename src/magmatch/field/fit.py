# SPDX-License-Identifier: BSD-3-Clause
"""From samples and fixed numbers to the posterior: what building and loading a map share, bit for bit."""

from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import Posterior
from magmatch.field.priors import PRIORS


def fit_posterior(samples: Survey, hyperparameters: Hyperparameters, config: FieldConfig) -> Posterior:
    """Posterior of the field given samples.

    Parameters
    ----------
    samples : Survey
        In the model's frame.
    hyperparameters : Hyperparameters
        Resolved numbers of the prior.
    config : FieldConfig
        Which prior.

    Returns
    -------
    Posterior
        In the model's frame; the same arguments give the same bits.
    """
    model = PRIORS[config.prior].build(samples.positions, samples.field, hyperparameters)
    return model.infer(model.observe(samples.positions, samples.field))
