# SPDX-License-Identifier: BSD-3-Clause
"""Configuration from a preset and a YAML file; errors name the setting."""

import json
from collections.abc import Sequence
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel, ValidationError

from magmatch.cli.option_values import one_of
from magmatch.errors import ConfigurationError, DataFormatError, first_fault
from magmatch.settings import over

if TYPE_CHECKING:
    from magmatch.registration.config import RegistrationConfig

Config = TypeVar("Config", bound=BaseModel)
# Schemas of results, which hold the settings they were made with.
RESULTS = ("magmatch.registration/", "magmatch.slam/", "magmatch.localization/")
# What can be estimated between the two magnetometers; 'auto' leaves it to the configuration.
SENSORS = ("auto", "none", "bias", "scale", "full")
# Bytes of a settings file, and of a result used as settings; stated in docs/formats.md.
MAX_BYTES, MAX_RESULT_BYTES = 1 << 20, 64 << 20


def registration_config(preset: str, path: Path | None, sensor: str = "auto") -> "RegistrationConfig":
    """Resolve the configuration of a registration: the file's settings over the preset's."""
    from magmatch.registration.config import PRESETS

    config = PRESETS[one_of("--preset", preset, PRESETS)]
    one_of("--sensor", sensor, SENSORS)
    config = merged(config, path)
    if sensor == "auto":
        return config
    if config.search == "keypoints" and sensor != "none":
        msg = f"--sensor {sensor}: these settings do not refine the pose, so none is estimated; use auto or none"
        raise ConfigurationError(msg)
    return type(config).model_validate(over(config.model_dump(), {"refinement": {"sensor": {"mode": sensor}}}))


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
        place, words = first_fault(error)
        first = error.errors()[0]
        if first["type"] == "extra_forbidden":
            words = _known_names(type(config), first["loc"])
        raise DataFormatError(path, words, column=place) from None


def read_settings(path: Path) -> dict[str, Any]:
    """Read settings from a YAML file or an earlier result."""
    content = _parsed(path)
    if isinstance(content, dict) and str(content.get("schema", "")).startswith(RESULTS):
        content = content.get("config")
    if content is None:
        return {}
    if not isinstance(content, dict):
        message = f"expected settings as 'name: value' lines, found {type(content).__name__}"
        raise DataFormatError(path, message)
    return {str(key): value for key, value in content.items()}


def _parsed(path: Path) -> Any:
    """Content of a YAML file, or of a result, which is JSON: a YAML parser would take a hundred times longer."""
    import yaml

    from magmatch.data.tables.text import read_bytes, text_lines
    from magmatch.data.tables.yaml_text import load_yaml

    raw = read_bytes(path, MAX_RESULT_BYTES + 1)
    if raw[:1] == b"{":
        with suppress(ValueError, RecursionError):  # a mapping in braces may be YAML
            return json.loads(raw)
    if len(raw) > MAX_BYTES:
        raise DataFormatError(path, f"is larger than any settings ({MAX_BYTES} bytes)")
    try:
        return load_yaml("\n".join(text_lines(path, raw)))
    except yaml.MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        raise DataFormatError(path, f"is not YAML: {error.problem or error.context}", line=line) from None
    except (yaml.YAMLError, ValueError) as error:
        if isinstance(error, DataFormatError):
            raise
        raise DataFormatError(path, f"is not YAML: {' '.join(str(error).split())[:200]}") from None


def _known_names(model: type[BaseModel], place: Sequence[int | str]) -> str:
    """The known setting nearest to an unknown one, or all of them."""
    for part in place[:-1]:
        inner = model.model_fields[str(part)].annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            model = inner
    near = get_close_matches(str(place[-1]), model.model_fields, 1)
    return "unknown setting; " + (
        f"did you mean '{near[0]}'?" if near else f"expected one of {', '.join(model.model_fields)}"
    )
