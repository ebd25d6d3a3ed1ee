# SPDX-License-Identifier: BSD-3-Clause
"""The base class of all settings: frozen, with errors in one sentence."""

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, cast

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from magmatch.errors import ConfigurationError, first_fault


class _OneSentence(type(BaseModel)):  # type: ignore[misc]  # pydantic gives its metaclass no public name
    """Turns pydantic's list of faults into the first of them, where settings are made by calling their class."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        if args:
            first = next(iter(cast("type[BaseModel]", cls).model_fields))
            msg = f"{cls.__name__}: expected settings by name, {first}=..., got {args[0]!r:.40}"
            raise TypeError(msg)
        try:
            return super().__call__(**kwargs)
        except ValidationError as error:
            place, words = fault_in(cls, error)
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


def fault_in(kind: Any, error: ValidationError) -> tuple[str, str]:
    """Say where settings of a class have their first fault, and what is wrong there, or which name may be meant."""
    place, words = first_fault(error)
    first = error.errors()[0]
    if first["type"] != "extra_forbidden":
        return place, words
    for part in first["loc"][:-1]:
        inner = kind.model_fields[str(part)].annotation
        kind = inner if isinstance(inner, type) and issubclass(inner, BaseModel) else kind
    near = get_close_matches(str(first["loc"][-1]), kind.model_fields, 1)
    known = f"did you mean '{near[0]}'?" if near else f"expected one of {', '.join(kind.model_fields)}"
    return place, f"unknown setting; {known}"
