# SPDX-License-Identifier: BSD-3-Clause
"""The base class of all settings: frozen, with errors in one sentence."""

from collections.abc import Mapping
from typing import Any, cast

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from magmatch.errors import ConfigurationError, first_fault


class _OneSentence(type(BaseModel)):  # type: ignore[misc]  # pydantic gives its metaclass no public name
    """Turns pydantic's list of faults into the first of them, where settings are made by calling their class."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        names = list(cast("type[BaseModel]", cls).model_fields)
        if args:
            msg = f"{cls.__name__}: expected settings by name, {names[0]}=..., got {args[0]!r:.40}"
            raise TypeError(msg)
        try:
            return super().__call__(**kwargs)
        except ValidationError as error:
            place, words = first_fault(error)
            first = error.errors()[0]
            if first["type"] == "extra_forbidden":
                known = f"one of {', '.join(names)}" if len(first["loc"]) == 1 else "a known setting"
                words = f"expected {known}, found another name"
            msg = ": ".join(part for part in (cls.__name__, place, words) if part)
            raise ConfigurationError(msg) from None


def of_vertical(*, planar: bool, no_gravity: bool) -> dict[str, object]:
    """Settings of slam and localisation that follow from what is known of the vertical; not both."""
    return {"is_planar": True} if planar else {"is_gravity_aligned": False} if no_gravity else {}


class Settings(BaseModel, metaclass=cast("Any", _OneSentence)):  # type: ignore[metaclass]
    """Settings of a step; reading them from files (`model_validate`) raises pydantic's own error."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _changed(cls, given: Any) -> Any:
        """A mapping given for a part changes what it names, and leaves the rest as this class has it by default."""
        if not isinstance(given, Mapping):
            return given
        fields = {name: field for name, field in cls.model_fields.items() if name in given}
        parts = {name: field.get_default(call_default_factory=True) for name, field in fields.items()}
        below = {name: part.model_dump() for name, part in parts.items() if isinstance(part, BaseModel)}
        changed = over(below, given)
        return {name: changed[name] for name in given}


def over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Merge nested settings; those above take precedence."""
    result = dict(below)
    for key, value in above.items():
        inner = result.get(key)
        result[key] = over(inner, value) if isinstance(inner, dict) and isinstance(value, Mapping) else value
    return result
