# SPDX-License-Identifier: BSD-3-Clause
"""Live estimate of the field: samples in one by one, predictions out at any time, over any distance."""

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.arguments import expect_kind, numbers_of, points_of, whole_number_of
from magmatch.data.checks import MAX_EXTENT, MAX_FIELD
from magmatch.data.survey import Survey
from magmatch.errors import SurveyError
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.live.live_cells import KEPT_PER_CELL, MeasuredCells
from magmatch.field.live.live_tiles import LiveTiles, Prediction
from magmatch.field.map import FieldMap
from magmatch.field.priors import PRIORS
from magmatch.field.tiles.tiles import Tiling
from magmatch.store import expect, load, naming, save
from magmatch.threads import single_threaded
from magmatch.typing import Points, Vectors

log = logging.getLogger(__name__)

SCHEMA = "magmatch.live/3"
# Samples that wait before cells take them in together: a call that fills this up takes about a millisecond longer.
N_WAITING = 256
# Samples from which the hyperparameters are chosen where none are given: a few hundred see several lengthscales.
# Below the fewest nothing can be said about lengthscale and noise.
N_FIRST, MIN_SAMPLES = 400, 10
# Side of a block, cells. Smaller ones are fitted faster, but more of them have a say at a place, and each sees its
# neighbours' data too: on walks and in rooms 16 costs a prediction least (bench_live.py --block).
BLOCK = 16
# Largest distance from the first sample, m, and largest component, T.
LIMITS = np.r_[np.full(3, MAX_EXTENT), np.full(3, MAX_FIELD)]


class FieldEstimator:
    """Estimate of the magnetic field that grows with the samples; the region need not be known beforehand.

    `update` costs microseconds. `predict` first fits the blocks of cells that its points touch and that have changed:
    at most eight around a point, however long the walk was. Each takes some ten milliseconds on a walk, a few hundred
    where cells are visited all over a plane or a room. Memory follows the number of cells visited: at most 22 kB
    each, whatever the time spent there.

    Not safe to use from several threads at once.

    Examples
    --------
    >>> estimator = FieldEstimator(Hyperparameters(0.5, 1e-5, 5e-7, 0.2, 100.0))
    >>> for x in np.linspace(0, 1, 50):
    ...     estimator.update([x, 0.0, 0.0], [20e-6, 0.0, -45e-6])
    >>> estimator.predict([[0.5, 0.0, 0.0]]).field.round(7)
    array([[ 2.0e-05,  0.0e+00, -4.5e-05]])
    """

    def __init__(
        self, hyperparameters: Hyperparameters | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        if hyperparameters is not None:
            expect_kind(hyperparameters, "hyperparameters", (Hyperparameters,))
            hyperparameters.check()
        _warm_up()
        self._clock = clock
        self._waiting, self._n_waiting = np.zeros((N_WAITING, 6)), 0
        self._start: np.ndarray | None = None
        # Samples that came before the hyperparameters were settled, and for how many they were last chosen.
        self._first: list[np.ndarray] | None = [] if hyperparameters is None else None
        self._n_chosen = 0
        self._tiles = None if hyperparameters is None else self._laid(hyperparameters)

    def __len__(self) -> int:
        n_first = sum(map(len, self._first or []))
        n_taken = n_first if self._first is not None or self._tiles is None else self._tiles.n_samples
        return n_taken + self._n_waiting

    @property
    def hyperparameters(self) -> Hyperparameters | None:
        """Numbers of the prior; None until they were given or chosen."""
        return None if self._tiles is None else self._tiles.hyperparameters

    @property
    def n_bytes(self) -> int:
        """Memory of what was measured; up to 0.5 GB of fitted blocks come on top."""
        return (0 if self._tiles is None else self._tiles.n_bytes) + sum(a.nbytes for a in self._first or [])

    def update(self, position: Points, field: Vectors, orientation: np.ndarray | None = None) -> None:
        """Add one sample or several.

        Parameters
        ----------
        position : (3,) or (n, 3) array, m, map frame
        field : (3,) or (n, 3) array, T
            In the map frame, or in the sensor's if orientations are given.
        orientation : (4,) or (n, 4) array, optional
            Quaternions xyzw that take sensor coordinates to map coordinates.

        Raises
        ------
        SurveyError
            NaN, or an impossible position or field; no sample of the call is added.
        ValueError
            The arrays' shapes do not match.
        """
        rows = _sample_rows(position, field, orientation)
        if self._start is None:
            _check_samples(rows, rows[0, :3] if len(rows) else np.zeros(3))
            self._start = rows[0, :3].copy() if len(rows) else None
        else:
            _check_samples(rows, self._start)
        while len(rows):
            taken = rows[: N_WAITING - self._n_waiting]
            self._waiting[self._n_waiting : self._n_waiting + len(taken)] = taken
            self._n_waiting += len(taken)
            rows = rows[len(taken) :]
            if self._n_waiting == N_WAITING:
                self._take_in()

    def predict(
        self, points: Points, order: int = 0, max_age: float = 0.0, *, with_variance: bool = True
    ) -> Prediction:
        """Field at points, from all samples up to now.

        Parameters
        ----------
        points : (n, 3) array, m, map frame
        order : int
            0: field; 1: and gradient; 2: and second derivatives.
        max_age : float, s
            Samples younger than this may be left out, so that a block is fitted again at most that often.
        with_variance : bool
            False leaves the variance NaN and saves its cost, which for hundreds of points per block is that of a fit.

        Raises
        ------
        SurveyError
            Fewer than 10 samples so far and no hyperparameters given, or none at all.
        """
        p = points_of(points)
        whole_number_of(order, "order", 0, 2)
        return self._ready().predict(p, order, max_age, with_variance=with_variance)

    def choose_hyperparameters(self) -> Hyperparameters:
        """Choose the hyperparameters again, from the stored samples (all those of cells visited briefly).

        The spacing of the cells is kept once sums have been formed over them.
        """
        tiles = self._ready()
        samples = np.concatenate(self._first) if self._first else tiles.kept
        chosen = _choose(samples)
        if len(samples) == tiles.n_samples:
            self._tiles = self._laid(chosen)
            self._tiles.absorb(samples)
        else:
            tiles.change(replace(chosen, spacing=tiles.hyperparameters.spacing))
        self._first = None
        return self._ready().hyperparameters

    def to_map(self) -> FieldMap:
        """Build a field map from the stored samples, with the same hyperparameters.

        In cells with more than 64 samples, these are the first 64; the log says how many others are not used.
        """
        tiles = self._ready()
        samples, h = tiles.kept, tiles.hyperparameters
        if len(samples) < len(self):
            log.warning("the map is made from %d of %d samples: at most 64 a cell are kept", len(samples), len(self))
        survey = Survey(samples[:, :3].copy(), samples[:, 3:].copy(), frame="map", name="live")
        config = FieldConfig(
            prior="spline", lengthscale=h.lengthscale, signal_sd=h.signal_sd, noise_sd=h.noise_sd, spacing=h.spacing
        )
        frame = RigidTransform.identity()
        return FieldMap(survey, fit_posterior(survey, h, config), frame, config, frame)

    def save(self, path: str | Path) -> None:
        """Write the complete state to one file, atomically, to continue from later.

        Parameters
        ----------
        path : path
            An existing file is replaced.

        Raises
        ------
        DataFormatError
            The folder does not exist.
        """
        self._take_in()
        content = {
            "hyperparameters": self.hyperparameters,
            "n_chosen": self._n_chosen,
            "start": self._start,
            "first": None if self._first is None else np.concatenate([np.zeros((0, 6)), *self._first]),
            "measured": None if self._tiles is None or not self._tiles.blocks else self._tiles.measured(),
        }
        save(path, SCHEMA, content)

    @classmethod
    def load(cls, path: str | Path, clock: Callable[[], float] = time.monotonic) -> Self:
        """Continue from a file written by `save`.

        Parameters
        ----------
        path : path
        clock : callable, optional

        Returns
        -------
        FieldEstimator
            Predicts what the saved one would have, bit for bit on the same machine.

        Raises
        ------
        DataFormatError
            Not a checkpoint, damaged, or of another version.
        """
        content = load(path, SCHEMA, (Hyperparameters, MeasuredCells))
        with naming(path):
            array = (np.ndarray, type(None))
            expect(content, n_chosen=int, start=array, first=array, measured=(MeasuredCells, type(None)))
            start, first, measured = (content[name] for name in ("start", "first", "measured"))
            estimator = cls(content["hyperparameters"], clock)
            estimator._start, estimator._n_chosen = start, content["n_chosen"]
            estimator._first = None if first is None else [_sample_rows(first[:, :3], first[:, 3:], None)]
            for rows in (first, None if measured is None else measured.kept):
                if rows is not None and len(rows):
                    _check_samples(rows, start)
            if measured is not None and estimator._tiles is not None:
                estimator._tiles.restore(measured)
        return estimator

    def _take_in(self) -> None:
        """Hand the waiting samples on, and settle the hyperparameters once there are enough."""
        if self._n_waiting:
            taken, self._n_waiting = self._waiting[: self._n_waiting].copy(), 0
            if self._tiles is not None:
                self._tiles.absorb(taken)
            if self._first is not None:
                self._first.append(taken)
        if self._first is not None and sum(map(len, self._first)) >= N_FIRST:
            self._choose_from_first()
            self._first = None

    def _ready(self) -> LiveTiles:
        """Tiles that hold all samples; before the hyperparameters are settled, with ones that are chosen for now."""
        self._take_in()
        n = len(self)
        if n == 0 or (self._tiles is None and n < MIN_SAMPLES):
            msg = f"expected at least {MIN_SAMPLES} samples before the first prediction, got {n}"
            raise SurveyError(msg)
        if self._tiles is None or (self._first is not None and n >= 2 * self._n_chosen):
            self._choose_from_first()
        assert self._tiles is not None
        return self._tiles

    def _choose_from_first(self) -> None:
        samples = np.concatenate(self._first or [])
        self._tiles, self._n_chosen = self._laid(_choose(samples)), len(samples)
        self._tiles.absorb(samples)

    def _laid(self, h: Hyperparameters) -> LiveTiles:
        return _lay_tiles(h, BLOCK, self._clock)


def _lay_tiles(h: Hyperparameters, block: int, clock: Callable[[], float]) -> LiveTiles:
    """Tiles without samples."""
    tiling = replace(Tiling.suited_to(h), core=block)
    return LiveTiles(h, tiling, clock)


@cache
def _warm_up() -> None:
    """Compile, or load what was compiled, before the first sample arrives."""
    tiles = _lay_tiles(Hyperparameters(1.0, 1e-5, 1e-6, 0.5), 4, time.monotonic)
    tiles.absorb(np.zeros((2 * KEPT_PER_CELL, 6)))
    tiles.predict(np.zeros((1, 3)), 2, 0.0, with_variance=True)


@single_threaded
def _choose(samples: np.ndarray) -> Hyperparameters:
    """Numbers that suit some samples."""
    h = PRIORS["spline"].choose_hyperparameters(samples[:, :3].copy(), samples[:, 3:].copy())
    log.info("hyperparameters from %d samples: %s", len(samples), h)
    return h


def _sample_rows(position: Points, field: Vectors, orientation: np.ndarray | None) -> np.ndarray:
    """Position and field in the map frame, one row a sample: (n, 6)."""
    p, b = numbers_of(position, "position", "(n, 3), in m"), numbers_of(field, "field", "(n, 3), in T")
    if p.shape != b.shape or p.shape[-1:] != (3,) or p.ndim > 2:
        msg = f"expected position and field both (3,) or both (n, 3), got {p.shape} and {b.shape}"
        raise ValueError(msg)
    if orientation is not None:
        q = numbers_of(orientation, "orientation", "(n, 4)")
        if q.shape != (*p.shape[:-1], 4):
            msg = f"expected orientation {(*p.shape[:-1], 4)}, quaternions xyzw, got {q.shape}"
            raise ValueError(msg)
        norm = np.linalg.norm(q, axis=-1)
        if not np.all(np.abs(norm - 1.0) < 1e-3):
            msg = f"expected orientation as unit quaternions xyzw, got one of length {np.ravel(norm)[0]:.3g}"
            raise SurveyError(msg)
        b = Rotation.from_quat(q).apply(b)
    rows = np.empty((p.size // 3, 6))
    rows[:, :3], rows[:, 3:] = p, b
    return rows


def _check_samples(rows: np.ndarray, start: np.ndarray) -> None:
    """Refuse what no magnetometer on a walk from ``start`` (m) reports."""
    offsets = rows.copy()
    offsets[:, :3] -= start
    is_good = (np.abs(offsets) <= LIMITS).all(axis=1)
    if is_good.all():
        return
    bad = int(np.argmin(is_good))
    found = f"sample {bad}: position {rows[bad, :3]} m, field {rows[bad, 3:]} T"
    if not np.isfinite(rows[bad]).all():
        msg = f"{found}: expected finite numbers, got NaN or infinity; leave it out"
    elif np.abs(rows[bad, 3:]).max() > MAX_FIELD:
        msg = f"{found}: expected a field below {MAX_FIELD} T; is it in tesla?"
    else:
        msg = f"{found}: expected a position within {MAX_EXTENT / 1e3:.0f} km of the first; is it in metres?"
    raise SurveyError(msg)
