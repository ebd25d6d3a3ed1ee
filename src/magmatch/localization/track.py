# SPDX-License-Identifier: BSD-3-Clause
"""A log as it was followed: what was known at each of its poses."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, groupby
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch._version import __version__
from magmatch.data.diagnoses import Diagnosis, diagnose, of_verticals
from magmatch.data.fingerprint import describe_input
from magmatch.data.survey import Survey
from magmatch.data.tables.tum import write_poses
from magmatch.data.trajectory import Trajectory
from magmatch.estimation.posterior import worst_sd
from magmatch.field.map import FieldMap
from magmatch.geometry import path_walked, transform_from_product
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import PoseEstimate
from magmatch.localization.result import LocalizationResult, LocalizationStatus, Segment
from magmatch.localization.samples import MOST_STEP
from magmatch.typing import Mask, Scalars

# What dead reckoning relies on, and no reading tells.
HELD = "dead reckoning takes the phone's upper end to point forward"
# Most moments at which a result gives the standard deviation.
MOST_SD = 200


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """A log through a map.

    Attributes
    ----------
    log : Survey
    maps : tuple of FieldMap
        The map; of an atlas, those in which a pose is stated.
    estimates : sequence of PoseEstimate
        One for each of the log's poses: with hindsight, or as it was known then.
    config : LocalizerConfig
    seconds : dict
        Per stage and total.
    places : dict
        Of an atlas: name of a map to the probability that the body is in it, as of the last stated pose, or of the
        end. What is left to 1 is that it is in none.
    """

    log: Survey
    maps: tuple[FieldMap, ...]
    estimates: Sequence[PoseEstimate]
    config: LocalizerConfig
    seconds: dict[str, float]
    places: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        n = int(self.is_stated.sum())
        return f"Track of {self.log.name!r}: a pose for {n} of {len(self.estimates)} samples, {len(self.maps)} maps"

    @property
    def is_stated(self) -> Mask:
        """Whether a pose is stated, (n,)."""
        return np.array([e.is_stated for e in self.estimates], dtype=np.bool_)

    @property
    def sd(self) -> Scalars:
        """Standard deviations of the stated poses in the worst direction, (m, 2): of place (m) and turn (rad)."""
        found = [worst_sd(e.covariance) for e in self.estimates if e.is_stated and e.covariance is not None]
        return np.array(found, dtype=np.float64).reshape(-1, 2)

    @property
    def poses(self) -> RigidTransform:
        """The stated ones, ``T_map_body``, at ``log.times[is_stated]``: fewer than the log's, or none at all."""
        stated = [e.matrix for e in self.estimates if e.matrix is not None]
        return transform_from_product(np.array(stated).reshape(-1, 4, 4))

    def save(self, path: str | Path, odometry: Trajectory | None = None) -> None:
        """Write the stated poses as TUM, on the log's clock; where there are none, a file without lines of data.

        Parameters
        ----------
        path : path
        odometry : Trajectory, optional
            The log's poses at their own times, where those are not its samples': the stated ones are then of these.
        """
        times, is_stated = self.log.times, self.is_stated
        assert times is not None
        if not is_stated.any():
            write_poses(path, times, None)
            return
        poses, times = self.poses, times[is_stated]
        if odometry is not None and self.log.orientations is not None:
            poses, times = self._carried(odometry)
        write_poses(path, times, poses)

    def _carried(self, odometry: Trajectory) -> tuple[RigidTransform, Scalars]:
        """Poses of a trajectory, each the last stated one before it and the odometry's move since; their times."""
        assert self.log.times is not None
        assert self.log.orientations is not None
        last = np.searchsorted(self.log.times, odometry.times, side="right") - 1
        rows = np.flatnonzero((last >= 0) & self.is_stated[last])
        samples = RigidTransform.from_components(self.log.positions, self.log.orientations)
        there = RigidTransform.from_components(odometry.positions, odometry.orientations)
        moves = samples[last[rows]].inv() * there[rows]
        is_step = np.linalg.norm(moves.translation, axis=1) < MOST_STEP
        nth_stated = np.cumsum(self.is_stated) - 1
        return (self.poses[nth_stated[last[rows]]] * moves)[is_step], odometry.times[rows][is_step]

    def result(self) -> LocalizationResult:
        """Give the findings as a document."""
        times, is_stated, last = self.log.times, self.is_stated, self.estimates[-1]
        assert times is not None
        wrong = [] if is_stated.any() else self._wrong()
        held = [HELD] if self.log.is_dead_reckoned and not is_stated.any() and last.probability > 0 else []
        reason = "; ".join([*map(str, wrong[:1]), last.reason, *held])
        found = LocalizationResult(
            LocalizationStatus.NEVER, reason, segments=tuple(self._segments()), is_planar=self.config.is_planar,
            seconds=dict(self.seconds), config=self.config.model_dump(mode="json"), version=__version__,
            inputs=tuple(describe_input(s) for s in (*(m.survey for m in self.maps), self.log)),
            maps=dict(self.places),
        )  # fmt: skip
        if not is_stated.any():
            return found
        first, final = int(np.argmax(is_stated)), self.estimates[int(np.flatnonzero(is_stated)[-1])]
        steps = np.diff(times, append=times[-1])
        sd, at, few = self.sd, times[is_stated], -(-int(is_stated.sum()) // MOST_SD)
        assert final.bias is not None
        assert final.bias_sd is not None
        return replace(
            found,
            status=LocalizationStatus.LOCALIZED if last.is_stated else LocalizationStatus.LOST,
            map=final.map,
            first_fix=(float(times[first]), float(path_walked(self.log.positions)[first])),
            share=float(np.clip((steps * is_stated).sum() / max(steps.sum(), 1e-9), 0.0, 1.0)),
            sd=tuple((float(t), float(a), float(b)) for t, (a, b) in zip(at[::few], sd[::few], strict=True)),
            sensor={
                "bias": final.bias.tolist(),
                "bias_sd": final.bias_sd.tolist(),
                "scale": float(final.gain or 1.0),
            },
            odometry={
                "scale": float(final.scale or 1.0),
                "sd": [float(final.drift or 1.0) * sd for sd in self.config.odometry.drift],
            },
        )

    def _wrong(self) -> list[Diagnosis]:
        """What is wrong with the log, or with taking z for up in it and in the map."""
        known = self.maps if self.config.is_gravity_aligned else ()
        found = (of_verticals(one.survey, self.log, names=("map", "log")) for one in known)
        return [*diagnose(self.log), *chain.from_iterable(found)]

    def _segments(self) -> list[Segment]:
        times, found = self.log.times, []
        assert times is not None
        runs = groupby(range(len(times)), lambda n: (self.estimates[n].phase, self.estimates[n].map))
        for rows in (list(run) for _, run in runs):
            e, t0, t1 = self.estimates[rows[0]], float(times[rows[0]]), float(times[rows[-1]])
            found.append(Segment(t0, t1, e.status, e.reason, e.map, e.is_place_known))
        return found
