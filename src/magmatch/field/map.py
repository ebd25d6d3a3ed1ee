# SPDX-License-Identifier: BSD-3-Clause
"""`FieldMap`: the posterior of the field over the region that a survey covers."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.arguments import (
    expect_kind,
    expect_path,
    expect_transform,
    number_of,
    points_of,
    rows_chosen,
    whole_number_of,
)
from magmatch.data.checks import require_one_frame, require_part
from magmatch.data.survey import Survey, subsets
from magmatch.data.units import field_text
from magmatch.errors import import_extra
from magmatch.field.axis_grid import map_on_grid
from magmatch.field.config import FieldConfig
from magmatch.field.excess import warn_of_excess
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import FieldPosterior, Index, StoredTile
from magmatch.field.saved_map import MapFile, MapRecord
from magmatch.field.sensor_biases import SensorBiases, biased_logs, shared_errors, solve_biases
from magmatch.field.tiles.region_model import tiles_to_store
from magmatch.field.values import FieldValues, GriddedField
from magmatch.geometry import transform_points
from magmatch.grid import RegularGrid
from magmatch.picture import with_picture
from magmatch.runner import Workers
from magmatch.typing import Mask, Points


@dataclass(frozen=True, eq=False, slots=True)
class FieldMap:
    """The magnetic field of a place, inferred from a survey, with its uncertainty.

    Attributes
    ----------
    survey : Survey
        The samples the map was made from, map frame.
    posterior : FieldPosterior
        The fitted model, in its own frame (principal axes of the survey).
    T_map_model : RigidTransform
        Takes model coordinates to map coordinates.
    config : FieldConfig
        How the map was made.
    T_domain_model : RigidTransform
        Takes model coordinates to the frame in which ``config.domain`` was given; does not change when the map moves.
    fitted_samples : Survey or None
        The samples in the model's frame as they were fitted. None as long as transforming `survey` gives the same;
        stored once the map was moved to another frame or saved, since transforming back would round.
    parts : tuple of Survey
        The surveys that were mapped together, in order; empty if there was only one.
    biases : SensorBiases or None
        Biases of the sensors of `surveys`, which were solved with the field and are taken out of their fields.
    file : MapFile or None
        Where the map was read from, and what is prepared of it may be kept (`magmatch.registration.index`). A map
        that is made of another one has no file.
    """

    survey: Survey
    posterior: FieldPosterior
    T_map_model: RigidTransform
    config: FieldConfig
    T_domain_model: RigidTransform
    fitted_samples: Survey | None = None
    parts: tuple[Survey, ...] = ()
    biases: SensorBiases | None = None
    file: MapFile | None = field(default=None, init=False)

    def __repr__(self) -> str:
        numbers = self.hyperparameters
        about = repr(self.survey).splitlines()[0].removeprefix("Survey ")
        return (
            f"FieldMap of {about}\nprior {self.config.prior}: lengthscale {numbers.lengthscale:.3g} m, "
            f"field varies by {field_text(numbers.signal_sd)}, noise {field_text(numbers.noise_sd)}"
        )

    def _repr_html_(self) -> str:
        return with_picture(repr(self), self.survey.picture())

    @property
    def surveys(self) -> tuple[Survey, ...]:
        """The surveys that the map was made from, map frame."""
        return self.parts or (self.survey,)

    @property
    def measured(self) -> Survey:
        """The samples as measured, with the biases of their sensors."""
        if self.biases is None:
            return self.survey
        first, *others = replace(self.biases, bias=-self.biases.bias).without(self.surveys)
        return first.merged(*others)

    @property
    def bias_spread(self) -> float:
        """Standard deviation of the biases of its logs' sensors, T; 0 where none were found."""
        return 0.0 if self.biases is None else self.biases.spread

    @property
    def hyperparameters(self) -> Hyperparameters:
        """Lengthscale, signal and noise of the prior."""
        return self.posterior.hyperparameters

    @property
    def follows_from(self) -> tuple[object, ...]:
        """All that the map follows from: it stands for the map where results are kept (`magmatch.runner`)."""
        return self.surveys, self.config, self.hyperparameters, self.T_domain_model, self.T_map_model

    def evaluate(self, points: Points, order: int = 0) -> FieldValues:
        """Posterior mean of the field and its derivatives.

        Parameters
        ----------
        points : (n, 3) array, m, map frame
            Where to evaluate.
        order : int
            0: field; 1: and gradient; 2: and second derivatives.

        Returns
        -------
        FieldValues
            Components in the map frame.
        """
        whole_number_of(order, "order", 0, 2)
        return self.posterior.evaluate(self._to_model(points), order).rotated(self.T_map_model)

    def covariance(self, points: Points, order: int = 0) -> np.ndarray:
        """Posterior covariance of the noise-free field, or of field and gradient, at each point.

        Parameters
        ----------
        points : (n, 3) array, m, map frame
            Where to evaluate.
        order : int
            0: field; 1: field, then gradient row-major (``bxx, bxy, ...``).

        Returns
        -------
        (n, 3, 3) or (n, 12, 12) array, T^2, T^2/m, T^2/m^2, map frame
            That of the prior where the map has no data.
        """
        whole_number_of(order, "order", 0, 1)
        turn = FieldValues.turning_matrix(self.T_map_model, order)
        return np.asarray(turn @ self.posterior.covariance(self._to_model(points), order) @ turn.T)

    def knows(self, points: Points) -> Mask:
        """Whether the map has data near each point (map frame): (n,) bool."""
        return self.posterior.knows(self._to_model(points))

    def draw(self, points: Points, n_draws: int, order: int, rng: np.random.Generator) -> list[FieldValues]:
        """Samples of the posterior at points, for the spread of any quantity derived from it.

        Parameters
        ----------
        points : (n, 3) array, m, map frame
            Where to evaluate.
        n_draws : int
            How many samples.
        order : int
            As in `evaluate`.
        rng : numpy Generator
            Source of randomness.

        Returns
        -------
        list of FieldValues
            One entry per sample, components in the map frame.
        """
        whole_number_of(n_draws, "n_draws", 1)
        whole_number_of(order, "order", 0, 2)
        expect_kind(rng, "rng", (np.random.Generator,), "np.random.default_rng(seed) makes one")
        weights = self.posterior.draw_weights(n_draws, rng)
        p_model = self._to_model(points)
        return [self.posterior.evaluate(p_model, order, w).rotated(self.T_map_model) for w in weights]

    def on_grid(self, grid: RegularGrid, order: int = 2, *, with_variance: bool = True) -> GriddedField:
        """Field, derivatives and variance on a regular grid.

        Parameters
        ----------
        grid : RegularGrid
            Where to evaluate, such as `grid_over` gives.
        order : int
            Highest derivative.
        with_variance : bool
            False leaves the variance NaN and saves its cost.
        """
        expect_kind(grid, "grid", (RegularGrid,), "grid_over(spacing) makes one")
        whole_number_of(order, "order", 0, 2)
        p_model = transform_points(grid.local_points(), self.T_map_model.inv() * grid.T_map_grid)
        values = self.posterior.evaluate(p_model, order)
        variance = np.full(grid.n_points, np.nan)
        if with_variance:
            variance = np.trace(self.posterior.covariance(p_model), axis1=1, axis2=2) / 3
        return GriddedField(grid, values.rotated(self.T_map_model), variance, self.posterior.knows(p_model))

    def grid_over(self, spacing: float, margin: float = 0.0) -> RegularGrid:
        """Grid over the samples with axes parallel to the model's, so that it rotates with the survey.

        Parameters
        ----------
        spacing : float, m
            Distance of neighbouring points.
        margin : float, m
            How far it reaches beyond the samples' box.
        """
        number_of(spacing, "spacing", "m", is_positive=True)
        number_of(margin, "margin", "m")
        return RegularGrid.over(self.survey.positions, spacing, margin, self.T_map_model)

    def to_xarray(self, spacing: float | None = None, cut: tuple[str, float] | None = None) -> Any:
        """Field, standard deviation and known region on a grid along the axes of the map's frame.

        Parameters
        ----------
        spacing : float, m, optional
            Distance of grid points; by default half a lengthscale, or more where that makes more than 100,000 points.
        cut : (str, float), optional
            Axis and coordinate (m) of a slice, such as ``("z", 1.0)``; the box of the samples by default.

        Returns
        -------
        xarray.Dataset
            ``bx, by, bz, sx, sy, sz, magnitude`` (T) and ``known`` over ``x, y, z`` (m).

        Raises
        ------
        MissingExtraError
            Needs xarray, which the extra ``grid`` brings.
        """
        import_extra("xarray", "FieldMap.to_xarray (xarray)", "grid")
        return map_on_grid(self, spacing, cut).to_xarray(self.survey.frame)

    def transformed(self, T_new_map: RigidTransform) -> "FieldMap":
        """Return the same map in another frame, to which ``T_new_map`` takes map coordinates."""
        expect_transform(T_new_map, "T_new_map")
        return replace(
            self,
            survey=self.survey.transformed(T_new_map),
            T_map_model=T_new_map * self.T_map_model,
            fitted_samples=self._fitted(),
            parts=tuple(part.transformed(T_new_map) for part in self.parts),
        )

    def with_surveys(self, *surveys: Survey, run: Workers | None = None) -> "FieldMap":
        """Return this map with more samples; frame, lattice and hyperparameters are kept.

        In a spline model, only the tiles that the new samples touch are fitted again.

        Parameters
        ----------
        *surveys : Survey
            In the map's frame.
        run : callable, optional
            Runs the tasks of a tiled fit; sequentially by default.
        """
        for survey in surveys:
            require_part(survey)
        require_one_frame([*self.surveys, *surveys])
        old, T_model_map = self._fitted(), self.T_map_model.inv()
        fitted = old.merged(*(survey.transformed(T_model_map, old.frame) for survey in surveys))
        parts, stored = (*self.surveys, *surveys), self._tiles()
        grown = self._refitted(parts, fitted, stored, run)
        biases = self._biases_added(grown, parts, fitted)
        if biases is not None and np.any(biases.bias[len(self.surveys) :]):
            new = biases.without(parts)[len(self.surveys) :]
            fitted = old.merged(*(survey.transformed(T_model_map, old.frame) for survey in new))
            grown = self._refitted((*self.surveys, *new), fitted, stored, run)
        grown = replace(grown, biases=biases)
        warn_of_excess(grown, grown.survey)
        return grown

    def without_samples(self, is_out: Mask, run: Workers | None = None) -> "FieldMap":
        """Return this map as fitted without some samples (n,) of all surveys; frame and hyperparameters are kept.

        In a spline model, only the tiles that contained these samples are fitted again.
        """
        if rows_chosen(is_out, len(self.survey)).dtype != np.bool_:
            msg = f"is_out: expected a mask of {len(self.survey)} samples, got indices; np.isin makes one"
            raise ValueError(msg)
        tiles = self._tiles()
        # A region in one piece has no tile that saw none of them.
        stored = tiles if len(tiles) > 1 else {}
        fewer = self._refitted(subsets(self.surveys, ~is_out), self._fitted().subset(~is_out), stored, run)
        return replace(fewer, biases=self.biases and self.biases.subset(self.surveys, ~is_out))

    def _biases_added(self, grown: "FieldMap", parts: tuple[Survey, ...], fitted: Survey) -> SensorBiases | None:
        """Biases of this map's logs, and of those that it grew by, solved with those of the others known."""
        known, n = self.biases, len(self.surveys)
        spread = self.config.sensor_bias_sd if known is None else known.spread
        R_model_map = self.T_map_model.rotation.inv()
        n_alike = shared_errors(self.posterior, self._fitted())
        new = [n + k for k in biased_logs(parts[n:])]
        found = solve_biases(grown.posterior, R_model_map, fitted, parts, new, spread, n_alike)
        if known is None:
            return found if found.spread > 0 else None
        rows = np.vstack([known.bias, found.bias[n:]]), np.vstack([known.sd, found.sd[n:]])
        return SensorBiases(*rows, known.spread)

    def _refitted(
        self, parts: tuple[Survey, ...], fitted: Survey, stored: dict[Index, StoredTile], run: Workers | None
    ) -> "FieldMap":
        """Same frame and numbers, other samples."""
        posterior = fit_posterior(fitted, self.hyperparameters, self.config, self.T_domain_model, stored, run)
        merged, parts = parts[0].merged(*parts[1:]), parts if len(parts) > 1 else ()
        return replace(self, survey=merged, posterior=posterior, fitted_samples=fitted, parts=parts)

    def save(self, path: str | Path) -> None:
        """Write the map to one file (layout in ``docs/formats.md``), whole or not at all.

        Parameters
        ----------
        path : path
            Where; an existing file is replaced. The same map gives the same bytes.

        Raises
        ------
        DataFormatError
            The folder does not exist.
        """
        tiles = self._tiles()
        MapRecord(
            self.surveys,
            self.T_map_model,
            self.config,
            self.hyperparameters,
            np.zeros(0) if tiles else self.posterior.weights,
            self._fitted(),
            self.T_domain_model,
            tiles,
            self.biases,
        ).write(path)

    @classmethod
    def load(cls, path: str | Path) -> "FieldMap":
        """Read a saved map and check it completely; a spline model is not fitted again.

        Parameters
        ----------
        path : path
            A file written by `save`.

        Returns
        -------
        FieldMap
            Gives the same numbers as the map that was saved, bit for bit on the same machine.

        Raises
        ------
        DataFormatError
            Not a map, damaged, of another version, or fitting does not give the field that was saved.
        """
        expect_path(path)
        record = MapRecord.read(path)
        loaded = cls(
            record.survey,
            record.restore(path),
            record.T_map_model,
            record.config,
            record.T_domain_model,
            record.fitted_samples,
            record.surveys if len(record.surveys) > 1 else (),
            record.biases,
        )
        if Path(path).is_file():  # nothing is kept beside a pipe
            object.__setattr__(loaded, "file", MapFile(Path(path).absolute(), record.sha256))
        return loaded

    def _tiles(self) -> dict[Index, StoredTile]:
        """Give what is stored of the fit, so that it need not be done again."""
        fitted = self._fitted()
        return tiles_to_store(self.posterior, fitted.positions, fitted.field)

    def _fitted(self) -> Survey:
        """Samples in the model's frame, to the bit as they were fitted."""
        if self.fitted_samples is not None:
            return self.fitted_samples
        return self.survey.transformed(self.T_map_model.inv())

    def _to_model(self, points: Points) -> Points:
        return transform_points(points_of(points), self.T_map_model.inv())
