# SPDX-License-Identifier: BSD-3-Clause
"""How certain an answer must be: command-line options as settings of a decision."""

from math import radians
from typing import TYPE_CHECKING, Any, TypeVar

from magmatch.cli.option_values import numbers, refuse
from magmatch.errors import ConfigurationError

if TYPE_CHECKING:
    from magmatch.localization.config import LocalizerConfig
    from magmatch.registration.config import RegistrationConfig

Config = TypeVar("Config", "RegistrationConfig", "LocalizerConfig")


def with_limits(config: Config, min_probability: float | None, max_sd: str | None) -> Config:
    """Put the minimum probability and the maximum standard deviation into the settings."""
    said: dict[str, Any] = {}
    if min_probability is not None:
        if not 0 < min_probability < 1:
            refuse("--min-probability", "a number between 0 and 1, such as 0.99", f"{min_probability:g}")
        said["min_probability"] = min_probability
    if max_sd is not None:
        metres, degrees = numbers("--max-sd", max_sd, 2, "metres,degrees, both above 0, such as 0.1,2")
        if metres <= 0 or not 0 < degrees <= 180:
            refuse("--max-sd", "metres above 0 and degrees from 0 to 180", max_sd)
        said |= {"max_sd_translation": metres, "max_sd_rotation": radians(degrees)}
    if not said:
        return config
    if getattr(config, "search", None) == "keypoints":
        msg = "--min-probability and --max-sd: the published method decides by its fitness and uses neither"
        raise ConfigurationError(msg)
    return type(config).model_validate(config.model_dump() | {"decision": config.decision.model_dump() | said})
