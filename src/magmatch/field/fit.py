# SPDX-License-Identifier: BSD-3-Clause
"""From samples and fixed hyperparameters to the posterior: shared by building and loading a map, bit for bit."""

from collections.abc import Mapping

from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.domain import BoundedPosterior, Box
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import FieldPosterior, Index, Prior, StoredTile
from magmatch.field.priors import prior_over
from magmatch.runner import Workers
from magmatch.threads import single_threaded


@single_threaded
def fit_posterior(
    samples: Survey,
    hyperparameters: Hyperparameters,
    config: FieldConfig,
    T_domain_model: RigidTransform | None = None,
    stored: Mapping[Index, StoredTile] | None = None,
    run: Workers | None = None,
) -> FieldPosterior:
    """Posterior of the field given samples in the model's frame; the same arguments give the same bits.

    ``T_domain_model`` takes model coordinates to those in which ``config.domain`` is given. Tiles of an earlier fit
    are reused if their inputs are identical; ``run`` fits the others.
    """
    box = Box.declared(config.domain, T_domain_model)
    return within(box, fit_unbounded(samples, hyperparameters, prior_over(config.prior, box), stored or {}, run))


def fit_unbounded(
    samples: Survey,
    hyperparameters: Hyperparameters,
    prior: Prior,
    stored: Mapping[Index, StoredTile],
    run: Workers | None,
) -> FieldPosterior:
    """Posterior of the field wherever the basis reaches."""
    points, field = samples.positions, samples.field
    return prior.build(points, field, hyperparameters).fit(points, field, stored, run)


def within(box: Box | None, posterior: FieldPosterior) -> FieldPosterior:
    """The posterior inside a box, its prior outside; unchanged without a box."""
    return posterior if box is None else BoundedPosterior(posterior, box)
