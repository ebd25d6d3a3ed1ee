# SPDX-License-Identifier: BSD-3-Clause
"""What the program says of a result."""

import pytest

from magmatch.cli.registering import tell_result
from magmatch.registration.result import RegistrationResult, Status


@pytest.mark.parametrize(
    ("probability", "words"),
    [(1e-7, "below 0.001"), (0.0314, "0.031"), (0.99951, "above 0.999"), (0.0, "below 0.001"), (1.0, "above 0.999")],
)
def test_a_probability_is_never_rounded_to_certainty(probability, words):
    result = RegistrationResult(
        status=Status.INCONSISTENT, reason="nothing fits", T_base_target=None, probability=probability
    )
    assert f"probability {words}," in tell_result(result)
