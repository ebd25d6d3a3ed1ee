# SPDX-License-Identifier: BSD-3-Clause
"""The verb of `register` and `demo`: as the library's, but keeping both maps for the picture."""

from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from magmatch.data.survey import Survey
    from magmatch.field.map import FieldMap
    from magmatch.registration.config import RegistrationConfig
    from magmatch.registration.result import RegistrationResult


def register_keeping_maps(
    base: "Survey | FieldMap", target: "Survey | FieldMap", settings: "RegistrationConfig", seed: int
) -> "tuple[FieldMap, FieldMap, RegistrationResult]":
    """Register, and hand on the maps that were made on the way.

    Parameters
    ----------
    base, target : Survey or FieldMap
        Each in its own frame.
    settings : RegistrationConfig
    seed : int

    Returns
    -------
    base_map, target_map : FieldMap
    result : RegistrationResult
        The same as `magmatch.register` gives; its seconds include the mapping.
    """
    from magmatch.registration.register import as_map, register
    from magmatch.registration.stopwatch import Stopwatch

    clock = Stopwatch()
    base_map = clock.time("base map", as_map, base, settings)
    target_map = clock.time("target map", as_map, target, settings)
    result = register(base_map, target_map, settings, seed=seed)
    mapping = clock.seconds()
    stages = {name: s for name, s in result.seconds.items() if name not in mapping}
    stages_of_maps = {name: s for name, s in mapping.items() if name != "total"}
    return base_map, target_map, replace(result, seconds=stages_of_maps | stages | {"total": mapping["total"]})
