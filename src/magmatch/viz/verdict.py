# SPDX-License-Identifier: BSD-3-Clause
"""A status has a meaning, and its user can do something next; the words for both are in ``advice.yaml``."""

from functools import cache
from importlib.resources import files
from typing import Any

import yaml

from magmatch.number_text import chance
from magmatch.registration.result import RegistrationResult


@cache
def _advice() -> Any:
    return yaml.safe_load(files("magmatch.viz").joinpath("advice.yaml").read_text(encoding="utf-8"))


def meaning(status: str) -> str:
    """What the status of a registration says of both surveys."""
    return str(_advice()[status]["meaning"])


def next_steps(status: str) -> list[str]:
    """What the user can do, the most promising first."""
    return list(_advice()[status]["next"])


def headline(result: RegistrationResult) -> str:
    """The answer of a registration in a line."""
    words = "Accepted" if result.is_accepted else f"Not accepted: {result.status.replace('_', ' ')}"
    if result.probability is not None:
        of = "" if result.is_accepted else "best candidate: "
        words += f" ({of}probability of being right {chance(result.probability)})"
    return words


def steps_after(result: RegistrationResult) -> list[str]:
    """What the user can do after a registration, without what its settings say already."""
    prior = result.config.get("prior", {})
    is_upright = prior.get("is_gravity_aligned") or prior.get("is_planar")
    steps = [step for step in next_steps(result.status) if not (is_upright and "--gravity-aligned" in step)]
    if result.alternatives and not result.is_accepted:
        steps.append(
            "The best candidate is drawn below and comes first under 'alternatives' in the result file. It is a "
            "guess to check, not an answer."
        )
    return steps
