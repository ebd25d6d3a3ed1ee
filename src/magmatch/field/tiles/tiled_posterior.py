# SPDX-License-Identifier: BSD-3-Clause
"""A fitted field of many tiles, blended: ``B = sum_k w_k B_k`` with smooth shares that sum to one.

The derivatives are those of the blend, grad w included, so the blended gradient is the gradient of the blended field.
Curl vanishes wherever one tile answers alone; where two blend it is ``sum grad w_k x B_k``, at most the largest
slope of a share times the difference of the tiles' fields.

Where a tile is missing (no sample near), its share goes to a constant field, the mean of the tiles', with the spread
of the prior.

Tiles share samples, so their errors are correlated, but the correlation is not stored. Whatever it is, the squared
error of a weighted mean is at most the weighted mean of the squared errors, by convexity, in the sense of matrices:
``cov B <= sum w_k cov B_k``. That bound is what `covariance` gives.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import Index, Piece
from magmatch.field.spline.spline_model import SplinePosterior
from magmatch.field.spline.spline_prior import outside_covariance
from magmatch.field.tiles.blending import Share, blended_covariance, blended_values, tile_shares
from magmatch.field.tiles.tile_fit import TileCache, TileTasks
from magmatch.field.tiles.tiled_draws import TiledDraw, draw_tile
from magmatch.field.tiles.tiles import TileKeys, Tiling
from magmatch.field.values import FieldValues
from magmatch.threads import side_by_side
from magmatch.typing import Mask, Matrix, Points, Scalars, Vector3


@dataclass(frozen=True, eq=False)
class TiledPosterior:
    """A fitted field of many tiles; fills `magmatch.field.linear_model.FieldPosterior`.

    ``tile_weights`` are the posterior means of each tile, (m + 3,), T; ``factored_tiles`` keeps some factors.
    """

    tasks: TileTasks
    tile_weights: list[Scalars]
    factored_tiles: TileCache = field(repr=False)
    _ready: TileCache = field(default_factory=TileCache, init=False, repr=False)

    @property
    def hyperparameters(self) -> Hyperparameters:
        """Numbers that shape the prior."""
        return self.tasks.hyperparameters

    @property
    def tiling(self) -> Tiling:
        """Sizes of the tiles."""
        assert self.tasks.tiling is not None
        return self.tasks.tiling

    @property
    def tiles(self) -> list[Index]:
        """All tiles, in ascending order."""
        return self.tasks.tiles

    @property
    def weights(self) -> Scalars:
        """Weights of all tiles, one after the other."""
        return np.concatenate(self.tile_weights)

    @property
    def weights_by_tile(self) -> Mapping[Index, Scalars]:
        """Weights of each tile."""
        return dict(zip(self.tiles, self.tile_weights, strict=True))

    @property
    def constant(self) -> Vector3:
        """Constant field where no tile answers, T."""
        return np.asarray(np.mean([w[-3:] for w in self.tile_weights], axis=0))

    def evaluate(self, points: Points, order: int = 0, weights: TiledDraw | None = None) -> FieldValues:
        """Field and derivatives at points; the posterior mean unless a draw is given."""

        def evaluate(number: int, p: Points) -> FieldValues:
            drawn = None if weights is None else weights.of_tile(number)
            return self.tile(number).evaluate(p, order, drawn)

        return blended_values(points, order, self.constant, self._shares(points, order), evaluate)

    def covariance(self, points: Points, order: int = 0) -> np.ndarray:
        """Bound of the posterior covariance of field (and gradient) at each point.

        Where no tile is, that of the prior and the spread of the tiles' constants.
        """
        size = 3 if order == 0 else 12
        spread = np.asarray(np.cov(np.array([w[-3:] for w in self.tile_weights]).T, bias=True))
        outside = outside_covariance(self.hyperparameters, spread)[:size, :size]
        return blended_covariance(points, order, outside, list(self._shares(points, order)), self.factored)

    def influence(self, points: Points) -> np.ndarray:
        """How the fitted field at samples follows what was measured at them: (3 n, 3 n), row ``3 i + a``.

        As if each tile bore on its neighbours with the square root of its share: exact inside of tiles.
        """
        n, shares = len(points), list(self._shares(points, 0))
        joints = side_by_side(lambda share: self.factored(share[0]).influence(points[share[1]]), shares)
        out = np.zeros((n, 3, n, 3))
        for (_, rows, weights), joint in zip(shares, joints, strict=True):
            root = np.sqrt(weights[0])
            shared = joint.reshape(len(rows), 3, len(rows), 3) * (root[:, None, None, None] * root[:, None])
            out[rows[:, None], :, rows] += shared.transpose(0, 2, 1, 3)
        return out.reshape(3 * n, 3 * n)

    def pieces(self, points: Points) -> Iterator[Piece]:
        """One for each tile; their shares of a sample sum to one."""
        (sees,) = self.tasks.rows
        for number, rows, weights in self._shares(points, 0):
            seen = sees[number][self.tiling.is_inside(points[sees[number]], self.tiles[number])]
            share = np.zeros(len(points))
            share[rows] = weights[0]
            yield Piece(self.factored(number), seen, share[seen])

    def draw_weights(self, n_draws: int, rng: np.random.Generator) -> Sequence[TiledDraw]:
        """Posterior samples, for `evaluate`; each tile's is computed when a point first falls into it."""
        seed = int(rng.integers(2**62))

        @cache
        def draws_of(number: int) -> Matrix:
            task, seen = self.tasks.task(number), self.tasks.rows[0][number]
            return draw_tile(task, seen, self.factored(number), n_draws, seed)

        return [TiledDraw(draws_of, k) for k in range(n_draws)]

    def without_factors(self) -> "TiledPosterior":
        """Few factors are ever kept."""
        return self

    def knows(self, points: Points) -> Mask:
        """Whether each point lies in an active cell."""
        known = np.zeros(len(points), dtype=bool)
        for number, rows in self.tiling.blended(points, self._keys):
            known[rows] |= self.tile(number).knows(points[rows])
        return known

    def tile(self, number: int) -> SplinePosterior:
        """Posterior of one tile, ready to be evaluated."""
        return self._ready.find(number, lambda: self.tasks.task(number).recall(self.tile_weights[number]))

    def factored(self, number: int) -> SplinePosterior:
        """Posterior of one tile that may be asked for its factors; few are kept, since they are large."""
        return self.factored_tiles.find(number, lambda: self.tasks.task(number).recall(self.tile_weights[number]))

    def _shares(self, points: Points, order: int) -> Iterator[Share]:
        """Each tile with a say at some points."""
        return tile_shares(self.tiling, self.tiles, self._keys, points, order)

    @cached_property
    def _keys(self) -> TileKeys:
        return TileKeys(self.tiles)
