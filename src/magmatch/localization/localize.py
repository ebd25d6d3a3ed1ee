# SPDX-License-Identifier: BSD-3-Clause
"""Localisation of a whole log in a known map: with hindsight, or as it would have been known live."""

from magmatch.arguments import expect_kind
from magmatch.data.survey import Survey
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.follow_log import follow_log
from magmatch.localization.hindsight import smooth
from magmatch.localization.known_places import KnownPlaces, Place
from magmatch.localization.track import Track
from magmatch.progress import Progress, followed


def localize(
    place: Place,
    log: Survey,
    config: LocalizerConfig | None = None,
    *,
    live: bool = False,
    progress: Progress | None = None,
) -> Track:
    """Localise a log in a map, or in one of a folder of maps, from an unknown start.

    Parameters
    ----------
    place : FieldMap, MapIndex or Atlas
        A rigid survey without odometry of its own is found in an atlas by `register`.
    log : Survey
        With times; positions and orientations from odometry, in its own frame, and the field in that frame. Without
        orientations the body is assumed to keep the odometry's axes.
    config : LocalizerConfig, optional
    live : bool
        Whether each pose is estimated from the samples up to it only, as a `Localizer` would have known it then.
        Otherwise the whole log is used for each.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.

    Returns
    -------
    Track
        An estimate for each of the log's poses, stated where it is probable and accurate enough.

    Raises
    ------
    SurveyError
        The log holds NaN, impossible values, too few samples or no times.
    """
    known = KnownPlaces(place)
    expect_kind(log, "log", (Survey,), "a log is a Survey with times; read_survey reads one")
    config = config or LocalizerConfig()
    expect_kind(config, "config", (LocalizerConfig,))
    with followed(progress):
        settled = config.settled(is_dead_reckoned=log.is_dead_reckoned)
        return (follow_log if live else smooth)(known, log, settled)
