# SPDX-License-Identifier: BSD-3-Clause
"""The interface of all priors: a linear basis with a Gaussian prior, ``B(x) = Phi(x) w``, ``w ~ N(0, P0^-1)``.

Data enter additively in information form, ``P = P0 + sum Phi^T Phi / s^2``, ``eta = sum Phi^T b / s^2``, so samples
can be left out by subtracting what they say. Everything here is in the model's own frame
(the survey's principal axes); `FieldMap` does the rotations.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from magmatch.errors import SurveyError
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.values import FieldValues
from magmatch.runner import Workers
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vectors

# Place of a tile on its lattice. A region that one factor can hold is its own tile (0, 0, 0).
Index = tuple[int, int, int]
# Largest change of the mean field at the samples that another machine's rounding may make, in noise_sd, and as a
# share of the field, of which the noise outdoors may be little; and at how many samples a refitted field is compared
# with the stored one.
REFIT_TOLERANCE, ROUNDING, N_CHECKED = 1e-6, 1e-9, 2000


@dataclass(frozen=True, slots=True, eq=False)
class StoredTile:
    """Fitted weights of a tile, and the fingerprint of everything that determines them."""

    weights: Scalars
    fingerprint: str


class LinearModel(Protocol):
    """One prior with fixed hyperparameters over one region."""

    def observe(self, points: Points, field: Vectors) -> Any:
        """Information in samples, from which that in some of them can be subtracted."""

    def infer(self, information: Any) -> "FieldPosterior":
        """Posterior of the weights given information (one factorisation)."""

    def fit(
        self, points: Points, field: Vectors, stored: Mapping[Index, StoredTile], run: Workers | None, /
    ) -> "FieldPosterior":
        """Posterior of samples; stored tiles with a matching fingerprint are reused, ``run`` fits the others."""


class Fit(Protocol):
    """What a linear fit makes of other fields at its samples; all is linear in them."""

    def loads(self, points: Points, fields: np.ndarray) -> Matrix:
        """What k fields (n, 3, k) at samples say of the weights: (m, k)."""

    def solve(self, loads: Matrix) -> Matrix:
        """Dual to `loads`: the products of other loads with these are those of their fields with the fitted ones."""


class Piece(NamedTuple):
    """One fit of those that a field is blended of, the rows of the samples it sees, and its share in each answer."""

    fit: Fit
    rows: Indices
    share: Scalars

    @classmethod
    def whole(cls, fit: Fit, points: Points) -> "Piece":
        """The one piece of a field that is not blended."""
        return cls(fit, np.arange(len(points)), np.ones(len(points)))


class FieldPosterior(Protocol):
    """A fitted field, in the model's frame."""

    @property
    def hyperparameters(self) -> Hyperparameters:
        """Numbers that shape the prior."""

    @property
    def weights(self) -> Scalars:
        """Posterior mean of the weights, (n_weights,): what a saved map is checked against when it is loaded."""

    @property
    def weights_by_tile(self) -> Mapping[Index, Scalars]:
        """Weights that a saved map stores, tile by tile; empty if loading fits the samples again."""

    def evaluate(self, points: Points, order: int = 0, weights: Any | None = None) -> FieldValues:
        """Field (order 0), gradient (1) and second derivatives (2); the posterior mean unless weights are given.

        Weights are an array such as `weights`, or one of `draw_weights`.
        """

    def covariance(self, points: Points, order: int = 0) -> np.ndarray:
        """Marginal posterior covariance at each point, returning to the prior far from data.

        Order 0: (n, 3, 3) of the field, T^2. Order 1: (n, 12, 12) of field, then gradient row-major.
        """

    def influence(self, points: Points) -> np.ndarray:
        """Derivative of the fitted field at samples by the measurements: (3 n, 3 n), row ``3 i + a``.

        In units of the noise, this is the posterior covariance of the fitted field.
        """

    def pieces(self, points: Points) -> Iterable[Piece]:
        """The fits that the field consists of; ``points``: all samples that it was fitted to."""

    def draw_weights(self, n_draws: int, rng: np.random.Generator) -> Iterable[Any]:
        """Posterior samples for `evaluate`, n_draws of them, in the model's own representation."""

    def without_factors(self) -> "FieldPosterior":
        """The mean alone, where many are kept: draws and covariances can no longer be asked for."""

    def knows(self, points: Points) -> Mask:
        """Say where the model has basis functions informed by data; elsewhere it falls back to the prior."""


def is_refit(posterior: FieldPosterior, weights: Scalars, points: Points) -> bool:
    """Whether stored weights give the field of a new fit where there are data, but for rounding."""
    if weights.shape != posterior.weights.shape:
        return False
    if np.array_equal(weights, posterior.weights):
        return True
    some = points[:: -(-len(points) // N_CHECKED)]
    field = posterior.evaluate(some).field
    change = field - posterior.evaluate(some, weights=weights).field
    most = REFIT_TOLERANCE * posterior.hyperparameters.noise_sd + ROUNDING * np.abs(field).max()
    return bool(np.abs(change).max() <= most)


def check_samples(points: Points, field: Vectors, fewest: int) -> None:
    """Refuse too few samples, NaN and infinity."""
    if len(points) < fewest:
        msg = f"expected at least {fewest} samples to fit a field, got {len(points)}"
        raise SurveyError(msg)
    if not (np.isfinite(points).all() and np.isfinite(field).all()):
        msg = "expected finite positions and field, got NaN or infinity"
        raise SurveyError(msg)


class Prior(Protocol):
    """A family of models; one file in ``field/priors`` each."""

    @property
    def name(self) -> str:
        """Name in the configuration."""

    @property
    def is_calibrated(self) -> bool:
        """Whether the chosen noise and spread hold for held-out samples; else `inducing.calibration` widens them."""

    def choose_hyperparameters(self, points: Points, field: Vectors) -> Hyperparameters:
        """Numbers that fit the data; deterministic."""

    def build(self, points: Points, field: Vectors, hyperparameters: Hyperparameters) -> LinearModel:
        """Place the basis over the region of the points."""
