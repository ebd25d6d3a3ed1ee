# SPDX-License-Identifier: BSD-3-Clause
"""`Localizer`: where a body is in a known map, sample by sample."""

from collections.abc import Callable

from scipy.spatial.transform import RigidTransform

from magmatch.arguments import expect_kind, expect_transform
from magmatch.localization.belief import BIN_LENGTH
from magmatch.localization.bins import Binning
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import LocalizerStatus, PoseEstimate, PoseHypothesis
from magmatch.localization.known_places import KnownPlaces, Place
from magmatch.localization.likely_maps import LikelyMaps
from magmatch.localization.samples import LastSample
from magmatch.threads import one_blas_thread
from magmatch.typing import Matrix, Vector3

FOUND_ELSEWHERE = "the path since the body was thought to have left the map is in the map elsewhere"


class Localizer:
    """Localise a body in a known map, from an unknown start, by drifting odometry and the measured field.

    Parameters
    ----------
    place : FieldMap, MapIndex, Atlas or KnownPlaces
        The map, or a folder of maps, one of which contains the body. Many bodies can share one `KnownPlaces`.
    config : LocalizerConfig, optional
    """

    def __init__(self, place: Place | KnownPlaces, config: LocalizerConfig | None = None) -> None:
        config = config or LocalizerConfig()
        expect_kind(config, "config", (LocalizerConfig,))
        with one_blas_thread():
            known = place if isinstance(place, KnownPlaces) else KnownPlaces(place)
            self._maps = LikelyMaps(known, config.settled())
        # While a trusted place is outside its map, nothing puts it to the test: the path since may be that of a body
        # that is in the map elsewhere, and is looked for as if the log began there.
        self._anew: LikelyMaps | None = None
        self._is_refuted = False  # the place trusted up to this sample
        self._samples = LastSample()
        self._binning = Binning(BIN_LENGTH * known.length)

    def update(self, t: float, T_odom_body: RigidTransform, field: Vector3) -> None:
        """Take a sample.

        Parameters
        ----------
        t : float, s
            Later than the sample before it.
        T_odom_body : RigidTransform
            The body's pose in the odometry's frame, which may drift.
        field : (3,) array, T
            In the body's axes.

        Raises
        ------
        ValueError, TypeError
            An invalid sample: NaN, a time before the last one, another unit, a jump. The state is unchanged.
        """
        expect_transform(T_odom_body, "T_odom_body")
        self.update_by_matrix(t, T_odom_body.as_matrix(), field)

    def update_by_matrix(
        self, t: float, T_odom_body: Matrix, field: Vector3, *, may_search: Callable[[], bool] = lambda: True
    ) -> None:
        """Take a sample whose pose is a rigid (4, 4) matrix, without creating SciPy objects.

        ``may_search`` is asked before each search; one that is not allowed now is due again one bin later.
        """
        sample = self._samples.take(t, T_odom_body, field)
        self._is_refuted = False
        new = self._binning.add(sample)
        if new is None:
            return
        self._maps.take(new, may_search)
        if not self._maps.is_outside:
            self._anew = None
            return
        self._anew = self._anew or LikelyMaps(self._maps.known, self._maps.config)
        self._anew.take(new, may_search)
        if self._anew.is_settled:
            self._maps, self._anew, self._is_refuted = self._anew, None, True

    def estimate(self, *, at_once: bool = False) -> PoseEstimate:
        """Give the present estimate; its ``T_map_body`` is None unless the pose is stated.

        ``at_once``: a place need not have stood before it is stated, since the caller will see whether it stands, and
        whether the pose is accurate enough in the end.
        """
        best = self._maps.best
        if self._is_refuted:
            return PoseEstimate(LocalizerStatus.LOST, FOUND_ELSEWHERE)
        if best is None:
            return PoseEstimate(LocalizerStatus.SEARCHING, self._maps.why_none)
        return best.estimate(self._samples.T_odom_body, at_once=at_once)

    def map_probabilities(self) -> dict[str, float]:
        """Give the probability of each likely map, by name; what is left to 1 is that the body is in none of them."""
        return self._maps.probabilities()

    def hypotheses(self) -> list[PoseHypothesis]:
        """List the competing hypotheses as of the last bin of the path, most likely first."""
        found = [one for belief in self._maps.likely.values() for one in belief.hypotheses()]
        return sorted(found, key=lambda one: -one.probability)
