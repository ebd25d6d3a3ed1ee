# SPDX-License-Identifier: BSD-3-Clause
"""A live log: windows are completed as samples arrive, and closures of each are then searched for."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.arguments import column_of, expect_transform, points_of
from magmatch.data.checks import MAX_FIELD, jumps, require_survey, too_large
from magmatch.data.survey import Survey
from magmatch.estimation.path_noise import PRIOR_STRETCHES
from magmatch.estimation.walk import BIN_LENGTH
from magmatch.field.folds import FEWEST_SAMPLES
from magmatch.field.sensor_biases import without_bias
from magmatch.geometry import path_moved
from magmatch.number_text import told
from magmatch.preparation.recalibrations import NEIGHBOURS
from magmatch.runner import Runner
from magmatch.slam.config import SlamConfig
from magmatch.slam.loop_closer import LoopCloser
from magmatch.slam.places import Places, begin, settled
from magmatch.slam.search.loop_closure import Candidate
from magmatch.slam.sensor_bias import in_one_calibration
from magmatch.slam.shared_hyperparameters import N_PARTS
from magmatch.slam.slam import close_near
from magmatch.slam.windows import Path, Window, mean_field, walked_along
from magmatch.threads import one_blas_thread
from magmatch.typing import Scalars, Vector3, Vectors

# Samples from which it is first learned how the field changes: of fewer, parts would show nothing. Learned from twice
# as many, its length is another if it is so many times as long, and not by chance.
FIRST_SAMPLES, LONGER = N_PARTS * FEWEST_SAMPLES, 1.5
# Samples before a window that show what of it is a jump of the sensor's own calibration.
LOOK_BACK = 4 * NEIGHBOURS


class LiveLog:
    """A log that grows sample by sample; places of earlier logs are not changed."""

    def __init__(self, config: SlamConfig, places: Places | None) -> None:
        self.config, self._run = config, Runner()
        self._closer = None if places is None else LoopCloser(places.copied(), self._run)
        # Of each sample: time (s), place (m), quaternion, and field (T) in odometry's axes
        self._samples: list[tuple[float, Vector3, np.ndarray, Vector3]] = []
        self._T_odom_body = RigidTransform.identity()
        self._path: Path | None = None
        # Samples on the way from which the field is learned, and all when there may be so many; earlier logs have
        # shown how it changes. Closures from which noise is learned.
        self._next_field: float = FIRST_SAMPLES if places is None else np.inf
        self._next_look, self._next_noise = self._next_field, PRIOR_STRETCHES
        # Samples that lie in windows; path since then, and the place it was measured to.
        self._n_cut, self._walked = 0, 0.0
        self._here = np.zeros(3)
        # Candidates of the last windows: near, and on other logs.
        self._near: list[list[Candidate]] = []
        self._far: list[list[Candidate]] = []

    @property
    def places(self) -> Places | None:
        """Windows and graph; None until enough was walked."""
        return None if self._closer is None else self._closer.places

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
        if self._samples and t <= (before := self._samples[-1][0]):
            msg = f"expected a time after {told(before)} s, that of the sample before, got {told(t)}"
            raise ValueError(msg)
        R, self._T_odom_body = T_odom_body.rotation, T_odom_body
        self._samples.append((t, T_odom_body.translation, R.as_quat(), R.apply(b)))
        if len(self._samples) >= self._next_look and self._learn_field():
            return True
        return self._closer is not None and self._walk(self._closer)

    def survey(self, first: int = 0) -> Survey:
        """Give all samples, or those from one on."""
        t, p, q, b = map(np.array, zip(*self._samples[first:], strict=True))
        return Survey(p, b, t, Rotation.from_quat(q), name="live")

    def pose(self) -> RigidTransform:
        """Pose of the body in the frame of the log's component, after the last sample; at first odometry's."""
        if self.places is None or self._path is None:
            return self._T_odom_body
        window = self._path.windows[-1]
        return self.places.graph.pose(window.node) * window.T_log_node.inv() * self._T_odom_body

    def _learn_field(self) -> bool:
        """Learn how the field changes, and search all that was walked with that; returns whether this was done.

        A short path shows short lengths only. So it is learned again from twice as many samples, until each part that
        it is learned from is as long as a window, and the field's length no longer grows.
        """
        survey = self.survey()
        walked = path_moved(survey.positions)
        n_moved = int((np.diff(walked) > 0).sum()) + 1
        self._next_look = len(survey) + max(self._next_field - n_moved, FEWEST_SAMPLES)
        if n_moved < self._next_field or _is_one_slope(survey.field, walked):
            return False  # it stood, or has seen too little
        require_survey(survey, name="log")
        with one_blas_thread():
            # From half of the parts: it is soon learned again.
            places = begin([survey], settled([survey], self.config), n_parts=N_PARTS // 2)
            if places.maker is None:
                return False  # nothing tells places apart
            known = 0.0 if self.places is None or self.places.maker is None else self.places.maker.length
            is_long = len(places.paths[0].windows) >= N_PARTS and places.maker.length < LONGER * known
            self._next_field = np.inf if is_long else 2 * n_moved
            self._next_look = len(survey) + self._next_field - n_moved
            self._closer, self._path, self._near = LoopCloser(places, self._run), places.paths[0], []
            close_near(self._closer, [self._path])
            self._next_noise = PRIOR_STRETCHES
            self._learn_noise(self._closer)
        self._cut_here()
        return True

    def _walk(self, closer: LoopCloser) -> bool:
        """Finish a window, once it is long enough."""
        places, here, length = closer.places, self._samples[-1][1], closer.search.maker.length
        if len(self._samples) == 1:
            self._here = here
        if (step := float(np.linalg.norm(here - self._here))) < BIN_LENGTH * length:
            return False  # jitter is no path
        self._walked, self._here = self._walked + step, here
        if self._walked < self.config.window_length * length or len(self._samples) - self._n_cut < 2:
            return False
        with one_blas_thread():
            if self._path is None:
                self._path = places.add(self.survey())
            else:
                self._path = places.paths[-1] = self._longer(self._path, places)
                places.solve()
            self._cut_here()
            self._look(self._path, closer)
        return True

    def _cut_here(self) -> None:
        self._n_cut, self._walked, self._here = len(self._samples), 0.0, self._samples[-1][1]

    def _longer(self, path: Path, places: Places) -> Path:
        """Give the path with one window more."""
        assert places.maker is not None
        length = places.maker.length
        # With a little of what is known, whose calibration the rest is given.
        known = max(self._n_cut - LOOK_BACK, 0)
        part = in_one_calibration(self.survey(known), 0)
        assert part.orientations is not None
        assert path.survey.times is not None
        assert part.times is not None
        shift = part.orientations[0].inv().apply(part.field[0] - path.survey.field[known])
        part = without_bias(part, shift).subset(np.arange(len(part)) >= self._n_cut - known)
        # One clock, which surveys that are merged need not have.
        times = np.concatenate([path.survey.times, part.times])
        whole = replace(path.survey.merged(part), name=path.survey.name, times=times)
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

    def _look(self, path: Path, closer: LoopCloser) -> None:
        """Search for the last window, and weigh its candidates by those of the windows before it."""
        n = min(self.config.run_length, len(path.windows))
        last = path.only(slice(-n, None))
        window = path.windows[-1]
        closed = {c.second for c in closer.places.graph.closures}
        self._near = [*self._near, *closer.search.near([window])][-n:]
        closer.close(last, [[]] * (n - len(self._near)) + self._near, closed)
        if closer.places.others(path):
            self._far = [*self._far, *closer.search.anywhere([window], path)][-n:]
            closer.connect(last, [[]] * (n - len(self._far)) + self._far, path)
        self._learn_noise(closer)

    def _learn_noise(self, closer: LoopCloser) -> None:
        """Learn noise and drift, if there are twice as many closures as the last time."""
        if len(closer.places.graph.closures) >= self._next_noise:
            closer.learn_noise()
            closer.learn_drift()
            self._path = closer.places.paths[-1]
            self._next_noise = 2 * len(closer.places.graph.closures)


def _is_one_slope(field: Vectors, walked: Scalars) -> bool:
    """Whether the field has only risen or fallen so far, and its length cannot be seen.

    Of a random walk each of n parts of the path holds 1 / n of its variance; of a slope, 1 / n^2.
    """
    part = np.minimum((walked / walked[-1] * N_PARTS).astype(np.int64), N_PARTS - 1)
    inside = sum(len(b) * b.var(axis=0).sum() for b in (field[part == k] for k in np.unique(part)))
    return bool(inside < len(field) * field.var(axis=0).sum() / N_PARTS)
