# SPDX-License-Identifier: BSD-3-Clause
"""A live log: windows are completed as samples arrive, and closures of each are then searched for."""

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.arguments import column_of, expect_transform, points_of
from magmatch.data.checks import MAX_FIELD, jumps, require_survey, too_large
from magmatch.data.survey import Survey
from magmatch.geometry import path_moved
from magmatch.registration.prepared.path_noise import PRIOR_STRETCHES
from magmatch.registration.prepared.walk import BIN_LENGTH
from magmatch.slam.config import SlamConfig
from magmatch.slam.find_places import begin, settled
from magmatch.slam.places import Places
from magmatch.slam.search.candidates import Candidate
from magmatch.slam.sensor_bias import without_bias
from magmatch.slam.shared_numbers import N_PARTS
from magmatch.slam.windows import Path, Window, mean_field, walked_along
from magmatch.threads import one_blas_thread
from magmatch.typing import Scalars, Vector3, Vectors

# Samples at which it is first tried to learn how the field changes, and their least growth until the next time.
FIRST_SAMPLES, LEAST_GROWTH = 64, 1.25


class LiveLog:
    """A log that grows sample by sample; places of earlier logs are not changed."""

    def __init__(self, config: SlamConfig, places: Places | None) -> None:
        self.config = config
        self.places = None if places is None else places.copied()
        self._t: list[float] = []
        self._p: list[Vector3] = []
        self._R: list[np.ndarray] = []
        self._b: list[Vector3] = []
        self._T_odom_body = RigidTransform.identity()
        self._path: Path | None = None
        self._next_try, self._next_learning = FIRST_SAMPLES, PRIOR_STRETCHES
        # Samples that lie in windows; path since then, and the place it was measured to.
        self._n_cut, self._walked = 0, 0.0
        self._here = np.zeros(3)
        # Candidates of the last windows: near, and on other logs.
        self._near: list[list[Candidate]] = []
        self._far: list[list[Candidate]] = []

    def add(self, t: float, T_odom_body: RigidTransform, field: Any) -> bool:
        """Add a sample; returns whether poses or windows changed.

        `ValueError` where the time does not increase or a number is impossible: the sample is not added.
        """
        t = float(column_of([t], "t", "s", 1)[0])
        expect_transform(T_odom_body, "T_odom_body")
        b = points_of(np.reshape(field, (1, -1)), "field", "T", "sample")[0]
        if not np.isfinite(T_odom_body.as_matrix()).all():
            msg = "T_odom_body: expected finite numbers, got NaN or infinity; leave such samples out"
            raise ValueError(msg)
        if (size := float(np.linalg.norm(b))) > MAX_FIELD:
            raise ValueError(too_large(size))
        if self._t and t <= self._t[-1]:
            msg = f"expected a time after {self._t[-1]:.9g} s, that of the sample before, got {t:.9g}"
            raise ValueError(msg)
        R = T_odom_body.rotation
        self._t.append(t)
        self._p.append(T_odom_body.translation)
        self._R.append(R.as_quat())
        self._b.append(R.apply(b))
        self._T_odom_body = T_odom_body
        return self._learn() if self.places is None else self._walk(self.places)

    def survey(self, first: int = 0) -> Survey:
        """All samples, or those from one on."""
        R = Rotation.from_quat(np.array(self._R[first:]))
        p, b, t = (np.array(values[first:]) for values in (self._p, self._b, self._t))
        return Survey(p, b, t, R, name="live")

    def pose(self) -> RigidTransform:
        """Body in the frame of the log's component, after the last sample; odometry's pose until that is known."""
        if self.places is None or self._path is None:
            return self._T_odom_body
        window = self._path.windows[-1]
        return self.places.graph.pose(window.node) * window.T_log_node.inv() * self._T_odom_body

    def _learn(self) -> bool:
        """Begin, as soon as windows can be compared."""
        if len(self._t) < self._next_try:
            return False
        survey = self.survey()
        walked = path_moved(survey.positions)
        if walked[-1] == 0:
            self._next_try *= 2
            return False  # it stands
        if _is_one_slope(survey.field, walked):
            self._next_try = round(self._next_try * LEAST_GROWTH)
            return False
        require_survey(survey, name="log")
        with one_blas_thread():
            places = begin([survey], settled([survey], self.config))
            # The field's numbers come from so many parts of the path, each of which must see as much as a window.
            if places.maker is None or (n := len(places.paths[0].windows)) < N_PARTS:
                share = 2.0 if places.maker is None else N_PARTS / n
                self._next_try = round(self._next_try * float(np.clip(share, LEAST_GROWTH, 2.0)))
                return False
            self.places, self._path = places, places.paths[0]
            places.solve()
            places.close_near([self._path])
        self._cut_here()
        return True

    def _walk(self, places: Places) -> bool:
        """Finish a window, once it is long enough."""
        assert places.maker is not None
        here, length = self._p[-1], places.maker.length
        if len(self._t) == 1:
            self._here = here
        if (step := float(np.linalg.norm(here - self._here))) < BIN_LENGTH * length:
            return False  # jitter is no path
        self._walked, self._here = self._walked + step, here
        if self._walked < self.config.window_length * length or len(self._t) - self._n_cut < 2:
            return False
        with one_blas_thread():
            if self._path is None:
                self._path = places.add(self.survey())
            else:
                self._path = places.paths[-1] = self._longer(self._path, places)
                places.solve()
            self._cut_here()
            self._look(self._path, places)
        return True

    def _cut_here(self) -> None:
        self._n_cut, self._walked, self._here = len(self._t), 0.0, self._p[-1]

    def _longer(self, path: Path, places: Places) -> Path:
        """The path with one window more."""
        assert places.maker is not None
        bias, length = places.biases[-1][0], places.maker.length
        part, whole = (without_bias(self.survey(first), bias) for first in (self._n_cut, 0))
        step = np.linalg.norm(whole.positions[self._n_cut] - whole.positions[self._n_cut - 1])
        walked = path.walked[-1] + step + walked_along(part, BIN_LENGTH * length)
        middle = int(np.searchsorted(walked, (walked[0] + walked[-1]) / 2))
        k, first = len(path.windows), path.windows[0]
        node, center = path.first_node + k, part.positions[middle]
        window = Window(first.log, node, part, center, length, first.config, mean_field(whole))
        return Path(
            whole,
            np.concatenate([path.walked, walked]),
            np.concatenate([path.number, np.full(len(part), k)]),
            (*path.windows, window),
            np.append(path.middles, self._n_cut + middle),
            path.first_node,
            jumps(whole),
        )

    def _look(self, path: Path, places: Places) -> None:
        """Search for the last window, and weigh its candidates by those of the windows before it."""
        n = min(self.config.run_length, len(path.windows))
        last = path.only(slice(-n, None))
        window = path.windows[-1]
        tied = {c.second for c in places.graph.closures}
        self._near = [*self._near, *places.near([window])][-n:]
        places.tie(last, [[]] * (n - len(self._near)) + self._near, tied)
        if places.others(path):
            self._far = [*self._far, *places.anywhere([window], path)][-n:]
            places.connect(last, [[]] * (n - len(self._far)) + self._far, path)
        if len(places.graph.closures) >= self._next_learning:
            places.learn_noise()
            places.learn_drift()
            self._path = places.paths[-1]
            self._next_learning = 2 * len(places.graph.closures)


def _is_one_slope(field: Vectors, walked: Scalars) -> bool:
    """Whether the field has only risen or fallen so far, and its length cannot be seen.

    Of a random walk each of n parts of the path holds 1 / n of its variance; of a slope, 1 / n^2.
    """
    part = np.minimum((walked / walked[-1] * N_PARTS).astype(np.int64), N_PARTS - 1)
    inside = sum(len(b) * b.var(axis=0).sum() for b in (field[part == k] for k in np.unique(part)))
    return bool(inside < len(field) * field.var(axis=0).sum() / N_PARTS)
