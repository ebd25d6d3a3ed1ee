# SPDX-License-Identifier: BSD-3-Clause
"""The spline potential as a linear model: cells, information of samples, posterior."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Self

import numpy as np

from magmatch.field.cholesky.cells import HALF_OFFSET, CellGrid, lay_cells
from magmatch.field.cholesky.multifrontal import Factors, factorise, refined_solve
from magmatch.field.cholesky.nested_dissection import Elimination, order_elimination
from magmatch.field.cholesky.point_solves import joint_covariances, marginal_covariances, solve_operations
from magmatch.field.cholesky.selected_inverse import selected_inverse
from magmatch.field.cholesky.stencil_matrix import StencilMatrix, sum_of_elements
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import Index, Piece
from magmatch.field.spline.spline_basis import FIRST, derivative_table, values_of
from magmatch.field.spline.spline_kernels import (
    add_gram,
    evaluate_points,
    linear_rows,
    point_covariances,
    right_hand_sides,
)
from magmatch.field.spline.spline_prior import (
    cell_precision,
    cell_weights,
    constant_precision,
    expand,
    prior_outside,
    relative_prior_precision,
)
from magmatch.field.values import FieldValues
from magmatch.typing import Mask, Matrix, Points, Scalars, Vectors

# Tile of a region that one factor can hold.
WHOLE: Index = (0, 0, 0)
# A few points are solved for one by one while that takes at most this share of the work of the selected inverse.
LARGEST_SHARE_FOR_SOLVES = 0.1
# `SplineModel.information_ratio` up to which a factor in single precision will do. A correction is smaller than the
# last by about this times single precision's rounding: four are needed, which take half the time that it saves.
HIGHEST_INFORMATION_RATIO = 1e5


@dataclass(frozen=True, eq=False, slots=True)
class SplineInformation:
    """The samples' information on the weights, in units of the noise: sums over samples, so they subtract."""

    gram: StencilMatrix  # ``sum W Phi^T Phi``
    eta: np.ndarray  # (m + 3,), T: ``sum W Phi^T b``
    square: float  # T^2: ``sum W |b|^2``
    n_values: float  # number of measured components

    def __sub__(self, other: "SplineInformation") -> "SplineInformation":
        """Leave samples out."""
        return SplineInformation(
            self.gram - other.gram, self.eta - other.eta, self.square - other.square, self.n_values - other.n_values
        )


@dataclass(frozen=True, eq=False, slots=True)
class SplineModel:
    """Splines over the cells near given points, with fixed hyperparameters."""

    hyperparameters: Hyperparameters
    elimination: Elimination  # over those cells

    @classmethod
    def over(cls, points: Points, hyperparameters: Hyperparameters) -> Self:
        """Lay splines over the surroundings of points."""
        cells = lay_cells(points, hyperparameters.spacing, hyperparameters.reach)
        return cls(hyperparameters, order_elimination(cells))

    @property
    def cells(self) -> CellGrid:
        """The cells that splines lie over."""
        return self.elimination.cells

    def observe(self, points: Points, field: Vectors, weights: Scalars | None = None) -> SplineInformation:
        """Information in samples; those outside the active cells inform the constant field alone."""
        m = self.cells.n_nodes
        weight = np.ones(len(points)) if weights is None else np.asarray(weights, dtype=np.float64)
        b = np.ascontiguousarray(field, dtype=np.float64)
        cell, t = self.cells.locate(points)
        gram, eta = StencilMatrix.zeros(m), np.zeros(m + 3)
        order = np.argsort(cell, kind="stable")
        order = order[np.searchsorted(cell[order], 0) :]
        add_gram(
            order, cell, t, b, weight, self.cells.cell_nodes, FIRST, HALF_OFFSET, gram.stencil, gram.border, eta[:m],
            *np.zeros((3, 4, 4)), np.zeros((3, 64)), np.zeros((64, 64)), np.zeros((64, 3)), np.zeros(64),
        )  # fmt: skip
        gram.corner[:] = weight.sum() * np.eye(3)
        eta[m:] = weight @ b
        return SplineInformation(gram, eta, float(weight @ (b**2).sum(axis=1)), float(b.size))

    def prior_precision(self) -> StencilMatrix:
        """Prior precision of the weights in units of the noise's, ``noise_sd^2 P0``."""
        h = self.hyperparameters
        stencil = sum_of_elements(self.cells, cell_precision(h), cell_weights(self.cells.distance))
        return StencilMatrix(stencil, np.zeros((len(stencil), 3)), np.eye(3) * constant_precision(h))

    def infer(self, information: SplineInformation) -> "SplinePosterior":
        """Posterior of the weights given information, with its factor."""
        factor = factorise(self.elimination, self.precision(information))
        return SplinePosterior(self.hyperparameters, self.cells, Factors.of(factor), factor.solve(information.eta))

    def infer_in_single_precision(self, information: SplineInformation) -> "SplinePosterior":
        """Infer the mean by a factor in single precision, in two thirds of the time; in double where that must be."""
        if self.information_ratio(information) > HIGHEST_INFORMATION_RATIO:
            return self.infer(information)
        A = self.precision(information)
        try:
            factor = factorise(self.elimination, A, np.float32)
        except np.linalg.LinAlgError:
            return self.infer(information)
        weights = refined_solve(A, factor, information.eta)
        if weights is None:
            return self.infer(information)
        factors = Factors(partial(factorise, self.elimination, A), factor)
        return SplinePosterior(self.hyperparameters, self.cells, factors, weights)

    def information_ratio(self, information: SplineInformation) -> float:
        """Measured values per cell over the prior's share: where it is large, single precision shows its rounding."""
        return information.n_values / self.cells.n_cells / relative_prior_precision(self.hyperparameters)

    def precision(self, information: SplineInformation) -> StencilMatrix:
        """Posterior precision times the noise variance."""
        return information.gram + self.prior_precision()


@dataclass(frozen=True, eq=False)
class SplinePosterior:
    """A fitted spline potential."""

    hyperparameters: Hyperparameters
    cells: CellGrid
    factors: Factors  # of the posterior precision times the noise variance; the mean does without
    weights: np.ndarray  # (m + 3,), T: posterior mean

    @property
    def weights_by_tile(self) -> Mapping[Index, Scalars]:
        """The region as one tile."""
        return {WHOLE: self.weights}

    def evaluate(self, points: Points, order: int = 0, weights: Scalars | None = None) -> FieldValues:
        """Field and derivatives at points; outside the active cells the constant field alone."""
        w = self.weights if weights is None else np.ascontiguousarray(weights, dtype=np.float64)
        derivatives = derivative_table(order)
        cell, t = self.cells.locate(points)
        out = np.zeros((len(cell), len(derivatives)))
        evaluate_points(
            cell, t, self.cells.cell_nodes, w, derivatives, self.cells.spacing, out, *np.zeros((3, 4, 4)),
            *np.zeros((2, 4, 4, 4)),
        )  # fmt: skip
        return values_of(out, w[-3:], order)

    def covariance(self, points: Points, order: int = 0) -> np.ndarray:
        """Posterior covariance of field (and gradient) at each point; the prior's outside the active cells.

        There the field has variance `signal_sd` squared beside the constant's; its gradient that of a lone cell.
        A few points are solved for; many take the selected inverse, which is computed once and kept.
        """
        derivatives, h = derivative_table(order), self.hyperparameters
        cell, t = self.cells.locate(points)
        unknowns, n_rows = self._unknowns(cell), len(derivatives)
        factor = self.factors.full
        e = factor.elimination
        affordable = LARGEST_SHARE_FOR_SOLVES * 2 * e.n_operations
        # Decided by the points alone, so that the same question gets the same bits whatever was asked before.
        if solve_operations(e, unknowns, n_rows) < affordable:
            out = marginal_covariances(factor, unknowns, self._rows(cell, t, derivatives))
        else:
            inverse, out = self._selected_inverse, np.zeros((len(cell), n_rows, n_rows))
            point_covariances(
                np.argsort(cell, kind="stable"), cell, t, self.cells.cell_nodes, derivatives, self.cells.spacing,
                HALF_OFFSET, inverse.stencil, inverse.border, inverse.corner, out,
            )  # fmt: skip
            out[cell < 0, :3, :3] = inverse.corner
        out *= (h.inflation * h.noise_sd) ** 2
        out[cell < 0] += prior_outside(h)[:n_rows, :n_rows]
        return out if order == 0 else expand(out)

    def influence(self, points: Points) -> np.ndarray:
        """How the fitted field at samples follows what was measured at them: (3 n, 3 n), row ``3 i + a``.

        To a thousandth.
        """
        cell, t = self.cells.locate(points)
        rows = self._rows(cell, t, derivative_table(0))
        return joint_covariances(self.factors.light, self._unknowns(cell), rows)

    def pieces(self, points: Points) -> list[Piece]:
        """One."""
        return [Piece.whole(self, points)]

    def loads(self, points: Points, fields: np.ndarray) -> Matrix:
        """Sums ``Phi^T b`` of fields, (m + 3, k)."""
        return right_hand_sides(self.cells, points, fields)

    def solve(self, loads: Matrix) -> Matrix:
        """Weights of the fields that are fitted to others, (m + 3, k)."""
        return self.factors.full.solve(loads)

    def draw_weights(self, n_draws: int, rng: np.random.Generator) -> Matrix:
        """Posterior samples of the weights, (n_draws, m + 3); their spread is right to a thousandth."""
        white = rng.standard_normal((len(self.weights), n_draws))
        scale = self.hyperparameters.inflation * self.hyperparameters.noise_sd
        return np.ascontiguousarray(self.weights + scale * self.factors.light.solve_half(white).T)

    def without_factors(self) -> "SplinePosterior":
        """The mean alone; the factors take a hundred times its memory."""
        return replace(self, factors=Factors.gone())

    def knows(self, points: Points) -> Mask:
        """Whether each point lies in an active cell."""
        return np.asarray(self.cells.locate(points)[0] >= 0)

    @cached_property
    def _selected_inverse(self) -> StencilMatrix:
        """It costs about twice a factorisation."""
        return selected_inverse(self.factors.full)

    def _unknowns(self, cell: np.ndarray) -> np.ndarray:
        """Unknowns of each point's cell (any cell's where it has none), then the constant: (n, 67)."""
        constant = np.tile(self.cells.n_nodes + np.arange(3), (len(cell), 1))
        return np.concatenate([self.cells.cell_nodes[np.maximum(cell, 0)], constant], axis=1)

    def _rows(self, cell: np.ndarray, t: Points, derivatives: np.ndarray) -> np.ndarray:
        """Rows of the linear model for `_unknowns`, (n, r, 67): the constant alone where there is no cell."""
        rows = np.zeros((len(cell), len(derivatives), 67))
        linear_rows(t, derivatives, self.cells.spacing, rows, *np.zeros((3, 4, 4)))
        rows[cell < 0, :, :64] = 0.0
        return rows
