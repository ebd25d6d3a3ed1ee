# SPDX-License-Identifier: BSD-3-Clause
"""A whole log, sample by sample as if live."""

import logging
from collections.abc import Sequence

from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.checks import require_survey
from magmatch.data.survey import Survey
from magmatch.errors import SurveyError
from magmatch.field.map import FieldMap
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import PoseEstimate
from magmatch.localization.known_places import KnownPlaces
from magmatch.localization.localizer import Localizer
from magmatch.localization.samples import OdometryJump
from magmatch.localization.track import Track
from magmatch.preparation.odometry.drift import lie_level
from magmatch.progress import tell
from magmatch.registration.clock import Clock
from magmatch.registration.maps import map_of, survey_of
from magmatch.threads import one_blas_thread

log = logging.getLogger(__name__)


def follow_log(known: KnownPlaces, walk: Survey, config: LocalizerConfig, *, at_once: bool = False) -> Track:
    """Localise a log as if live; see `localize`, and `Localizer.estimate`."""
    require_survey(walk, name="log")
    if walk.times is None:
        msg = f"{walk.name}: expected a log with times, got none; add a column t (s)"
        raise SurveyError(msg)
    clock = Clock()
    if config.is_gravity_aligned and not config.is_planar and _is_level(known, walk):
        log.info("all poses of map and log lie at one height each: taken as planar")
        config = config.model_copy(update={"is_planar": True})
    R = walk.orientations if walk.orientations is not None else Rotation.identity(len(walk))
    poses, field = RigidTransform.from_components(walk.positions, R), R.inv().apply(walk.field)
    with one_blas_thread():
        with clock("map"):
            localizer = Localizer(known, config)
        estimates: list[PoseEstimate] = []
        # Which map: as of the last stated pose, or of the end where none is.
        places: dict[str, float] = {}
        with clock("follow"):
            for n, t in enumerate(walk.times):
                if n % 1000 == 0:
                    tell(f"following {walk.name}", n / len(walk))
                try:
                    localizer.update(float(t), poses[n], field[n])
                except OdometryJump as jump:
                    log.warning("%s: sample %d: %s", walk.name, n, jump)
                estimates.append(localizer.estimate(at_once=at_once))
                if known.atlas and estimates[-1].is_stated:
                    places = localizer.map_probabilities()
            if known.atlas and not any(e.is_stated for e in estimates):
                places = localizer.map_probabilities()
    return Track(walk, _maps(known, estimates), estimates, config, clock.seconds(), places)


def _is_level(known: KnownPlaces, walk: Survey) -> bool:
    """Whether the log keeps one height, and the map does; of an atlas nobody looked."""
    return known.alone is not None and all(lie_level([s]) for s in (walk, survey_of(known.alone)))


def _maps(known: KnownPlaces, estimates: Sequence[PoseEstimate]) -> tuple[FieldMap, ...]:
    """The map; of an atlas, those in which a pose is stated."""
    if known.alone is not None:
        return (map_of(known.alone),)
    named = {e.map for e in estimates}
    assert known.atlas is not None
    return tuple(known.atlas.load(entry).field_map for entry in known.atlas.entries if entry.name in named)
