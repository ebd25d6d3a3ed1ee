# SPDX-License-Identifier: BSD-3-Clause
"""Localisation of a whole log, sample by sample as if live; a rigid target is registered to an atlas instead."""

from typing import overload

from magmatch.arguments import expect_kind
from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.follow_log import follow_log
from magmatch.localization.known_places import Place
from magmatch.localization.localizer import ADVICE
from magmatch.localization.track import Track
from magmatch.progress import Progress, followed
from magmatch.registration.index.atlas import Atlas
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.register import register
from magmatch.registration.result import RegistrationResult


@overload
def localize(
    place: Atlas, target: Survey | FieldMap, config: None = None, *, seed: int = 0, progress: Progress | None = None
) -> RegistrationResult: ...
@overload
def localize(
    place: Place, target: Survey, config: LocalizerConfig, *, seed: int = 0, progress: Progress | None = None
) -> Track: ...
@overload
def localize(
    place: FieldMap | MapIndex, target: Survey, *, seed: int = 0, progress: Progress | None = None
) -> Track: ...
def localize(
    place: Place,
    target: Survey | FieldMap,
    config: LocalizerConfig | None = None,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Track | RegistrationResult:
    """Localise a log in a map, or find the map of an atlas that contains a rigid survey.

    Parameters
    ----------
    place : FieldMap, MapIndex or Atlas
    target : Survey or FieldMap
        A log: a survey with times; positions and orientations from odometry, in its own frame, and the field in that
        frame. Without orientations the body is assumed to keep the odometry's axes. With an atlas and without
        `config`: a rigid survey or map, which is registered.
    config : LocalizerConfig, optional
    seed : int
        Of the registration; localising a log uses no random numbers.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.

    Returns
    -------
    Track
        Of a log.
    RegistrationResult
        Of a rigid target; ``base`` names the map, alternatives name theirs.

    Raises
    ------
    SurveyError
        The log holds NaN, impossible values, too few samples or no times.
    """
    expect_kind(place, "place", (FieldMap, MapIndex, Atlas), ADVICE)
    if isinstance(place, Atlas) and config is None:
        return register(place, target, seed=seed, progress=progress)
    expect_kind(target, "target", (Survey,), "a log is a Survey with times; read_survey reads one")
    assert isinstance(target, Survey)
    with followed(progress):
        return follow_log(place, target, config)
