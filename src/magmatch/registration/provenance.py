# SPDX-License-Identifier: BSD-3-Clause
"""The provenance in a result: enough to repeat the run and get the same numbers."""

from collections.abc import Iterable
from dataclasses import replace

from magmatch._version import __version__
from magmatch.data.fingerprint import describe_input
from magmatch.data.survey import Survey
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.result import RegistrationResult


def stamped(
    answer: RegistrationResult, inputs: Iterable[Survey], config: RegistrationConfig, seed: int, clock: Clock
) -> RegistrationResult:
    """An answer with its settings, version, seed, inputs (names and hashes) and seconds."""
    return replace(
        answer,
        seconds=clock.seconds(),
        config=config.model_dump(mode="json"),
        version=__version__,
        seed=seed,
        inputs=tuple(describe_input(survey) for survey in inputs),
    )
