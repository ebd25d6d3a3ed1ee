# SPDX-License-Identifier: BSD-3-Clause
"""Configuration from a preset, a YAML file and options; errors name the setting or the option."""

import json
from contextlib import suppress
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from pydantic import BaseModel, ValidationError

from magmatch.cli.inputs import read_result
from magmatch.cli.option_values import numbers, refuse
from magmatch.data.units import MEBI
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.settings import fault_in, over

if TYPE_CHECKING:
    from magmatch.localization.config import LocalizerConfig
    from magmatch.registration.config import RegistrationConfig

Config = TypeVar("Config", bound=BaseModel)
Decided = TypeVar("Decided", "RegistrationConfig", "LocalizerConfig")
# Schemas of results, which hold the settings they were made with.
RESULTS = ("magmatch.registration/", "magmatch.slam/", "magmatch.localization/")
# Where settings start; and what is estimated between the magnetometers, which 'auto' leaves to the configuration.
Preset = Literal["default", "paper", "paper-literal"]
Sensor = Literal["auto", "none", "bias", "scale", "full"]
# Bytes of a settings file, and of a result used as settings; stated in docs/formats.md.
MAX_BYTES, MAX_RESULT_BYTES = MEBI, 64 * MEBI


def registration_config(preset: Preset, path: Path | None, sensor: Sensor = "auto") -> "RegistrationConfig":
    """Resolve the configuration of a registration: the file's settings over the preset's."""
    from magmatch.registration.config import PRESETS

    config = merged(PRESETS[preset], path)
    if sensor == "auto":
        return config
    if config.search == "keypoints" and sensor != "none":
        msg = f"--sensor {sensor}: these settings do not refine the pose, so none is estimated; use auto or none"
        raise ConfigurationError(msg)
    return _changed(config, "refinement", {"sensor": {"mode": sensor}})


def merged(config: Config, path: Path | None, part: str = "") -> Config:
    """Override a configuration with the settings of a file, or with a part of them if the file has it."""
    if path is None:
        return config
    settings = read_settings(path)
    if part and isinstance(settings.get(part), dict):
        settings = settings[part]
    try:
        return type(config).model_validate(over(config.model_dump(), settings))
    except ValidationError as error:
        place, words = fault_in(type(config), error)
        raise DataFormatError(path, f"{place}: {words}") from None


def with_limits(config: Decided, min_probability: float | None, max_sd: str | None) -> Decided:
    """Put the minimum probability and the maximum standard deviation into the settings."""
    said: dict[str, Any] = {}
    if min_probability is not None:
        if not 0 < min_probability < 1:
            refuse("--min-probability", "a number between 0 and 1, such as 0.99", f"{min_probability:g}")
        said["min_probability"] = min_probability
    if max_sd is not None:
        said["max_sd_translation"], said["max_sd_rotation"] = _spread("--max-sd", max_sd, "0.1,2")
    if said and getattr(config, "search", None) == "keypoints":
        msg = "--min-probability and --max-sd: the published method decides by its fitness and uses neither"
        raise ConfigurationError(msg)
    return _changed(config, "decision", said)


def with_prior(
    config: "RegistrationConfig",
    *,
    is_aligned: bool,
    is_planar: bool,
    gravity_sd: float | None = None,
    pose: str | None = None,
    pose_sd: str | None = None,
) -> "RegistrationConfig":
    """Put the pose prior into the settings."""
    flags = {"is_gravity_aligned": is_aligned, "is_planar": is_planar}
    said: dict[str, Any] = {name: True for name, is_said in flags.items() if is_said}
    if pose is not None:
        said["pose"] = _prior_pose(pose)
    if pose_sd is not None:
        if pose is None and config.prior.pose is None:
            msg = "--prior-pose-sd: there is no rough pose; give --prior-pose too"
            raise ConfigurationError(msg)
        said["sd_translation"], said["sd_rotation"] = _spread("--prior-pose-sd", pose_sd, "1,10")
    if gravity_sd is not None:
        if not (is_aligned or is_planar or config.prior.is_upright):
            msg = "--gravity-sd: give --gravity-aligned or --planar too"
            raise ConfigurationError(msg)
        said["gravity_sd"] = radians(gravity_sd)
    return _changed(config, "prior", said)


def _changed(config: Config, part: str, said: dict[str, Any]) -> Config:
    """Settings of which one part is as said; unsaid, they stay."""
    return type(config).model_validate(over(config.model_dump(), {part: said})) if said else config


def _prior_pose(text: str) -> tuple[float, ...]:
    """Seven numbers, as given, or the pose of a result: its best candidate if it was not accepted."""
    if "," not in text or Path(text).is_file():
        T = read_result(Path(text)).best_pose
        if T is None:
            msg = f"--prior-pose: {text} holds no pose, accepted or not"
            raise ConfigurationError(msg)
        return (*map(float, T.translation), *map(float, T.rotation.as_quat()))
    x, y, z, *q = numbers("--prior-pose", text, 7, "x,y,z,qx,qy,qz,qw (m; a unit quaternion) or a result's file")
    norm = sum(c * c for c in q) ** 0.5
    if not 0.99 < norm < 1.01:
        msg = f"--prior-pose: expected a unit quaternion qx,qy,qz,qw, found one of length {norm:.3g}"
        raise ConfigurationError(msg)
    return (x, y, z, *(c / norm for c in q))


def _spread(option: str, text: str, example: str) -> tuple[float, float]:
    """Metres above 0, and degrees above 0 as rad."""
    metres, degrees = numbers(option, text, 2, f"metres,degrees, both above 0, such as {example}")
    if metres <= 0 or not 0 < degrees <= 180:
        refuse(option, "metres above 0 and degrees from 0 to 180", text)
    return metres, radians(degrees)


def read_settings(path: Path) -> dict[str, Any]:
    """Read settings from a YAML file or an earlier result."""
    from magmatch.data.tables.yaml_text import mapping_in

    content = _parsed(path)
    if str(mapping_in(content).get("schema")).startswith(RESULTS):
        content = content.get("config")
    if content is None:
        return {}
    if not isinstance(content, dict):
        message = f"expected settings as 'name: value' lines, found {type(content).__name__}"
        raise DataFormatError(path, message)
    return {str(key): value for key, value in content.items()}


def _parsed(path: Path) -> Any:
    """Content of a YAML file, or of a result, which is JSON: a YAML parser would take a hundred times longer."""
    from magmatch.data.tables.text import read_bytes
    from magmatch.data.tables.yaml_text import read_yaml

    raw = read_bytes(path, MAX_RESULT_BYTES + 1)
    if raw[:1] == b"{":
        with suppress(ValueError, RecursionError):  # a mapping in braces may be YAML
            return json.loads(raw)
    if len(raw) > MAX_BYTES:
        raise DataFormatError(path, f"is larger than any settings ({MAX_BYTES} bytes)")
    return read_yaml(path, raw)
