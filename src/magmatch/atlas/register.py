# SPDX-License-Identifier: BSD-3-Clause
"""`register` for any base: a survey, a map, or a folder of maps."""

import os
from collections.abc import Sequence
from pathlib import Path

from scipy.spatial.transform import RigidTransform

from magmatch.atlas.atlas import Atlas, open_atlas
from magmatch.atlas.localize import localize_keeping_map
from magmatch.data.tables.text import is_folder
from magmatch.errors import ConfigurationError
from magmatch.field.map import FieldMap
from magmatch.progress import Progress, followed
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.maps import require_target
from magmatch.registration.register import given_poses, register_keeping_maps
from magmatch.registration.result import RegistrationResult
from magmatch.registration.search.candidate import NONE_GIVEN, Given
from magmatch.registration.steps import Base, Target


def register(
    base: Base | Atlas | str | Path,
    target: Target,
    config: RegistrationConfig | None = None,
    *,
    candidates: Sequence[RigidTransform] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> RegistrationResult:
    """Find the rigid transform between two magnetic surveys of one place, or say why there is none.

    Parameters
    ----------
    base : Survey, FieldMap, MapIndex, Atlas or path of a folder of saved maps
        Defines the frame; a survey is mapped first. For many targets, pass the base as a `MapIndex`. With many maps,
        the result's ``base`` names the one that contains the target.
    target : Survey or FieldMap
        In its own frame.
    config : RegistrationConfig, optional
        Preset ``default`` unless given; ``PRESETS["paper"]`` is the published method, ``"paper-literal"`` the same to
        the letter. An `Atlas` has its own.
    candidates : list of RigidTransform
        ``T_base_target`` from elsewhere, weighed beside those that the search finds. Alone: `judge`.
    seed : int
        Same input, configuration and seed give the same answer bit for bit.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.

    Returns
    -------
    RegistrationResult
        ``T_base_target`` is None unless accepted; ``reason`` says why.

    Raises
    ------
    SurveyError
        A survey holds NaN, impossible values or too few samples.
    TypeError
        Neither surveys nor maps; says how to convert what was given.
    """
    with followed(progress):
        return register_anywhere(base, target, config, seed=seed, given=given_poses(candidates))[2]


def register_anywhere(
    base: Base | Atlas | str | Path,
    target: Target,
    config: RegistrationConfig | None = None,
    *,
    seed: int = 0,
    given: Given = NONE_GIVEN,
) -> tuple[FieldMap | MapIndex | None, Target, RegistrationResult]:
    """Register, and also return the base (None if none of many fits) and the target as they were used."""
    if isinstance(base, str | os.PathLike) and is_folder(base):
        require_target(target)
        base, config = open_atlas(base, config), None
    if not isinstance(base, Atlas):
        return register_keeping_maps(base, target, config, seed=seed, given=given)  # type: ignore[arg-type]  # refuses other paths
    if given.poses:
        msg = "candidates: poses in which of many maps? give one map as the base"
        raise ConfigurationError(msg)
    if config is not None and config != base.config:
        msg = (
            "config: expected that of the Atlas, or none, got another; open_atlas(folder, config) opens it with this"
        )
        raise ConfigurationError(msg)
    used, result = localize_keeping_map(base, target, seed=seed)
    named = [entry for entry in base.entries if entry.name == result.base]
    return base.load(named[0]) if named else None, used, result
