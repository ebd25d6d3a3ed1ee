# SPDX-License-Identifier: BSD-3-Clause
"""What a report advises after a refusal."""

import pytest

from magmatch.registration.config import RegistrationConfig
from magmatch.registration.result import RegistrationResult, Status
from magmatch.viz.verdict import next_steps


@pytest.mark.parametrize("status", [Status.AMBIGUOUS, Status.UNINFORMATIVE])
@pytest.mark.parametrize("known", ["is_gravity_aligned", "is_planar"])
def test_what_is_known_already_is_not_asked_for(status, known):
    def advised(prior):
        config = RegistrationConfig.model_validate({"prior": prior}).model_dump(mode="json")
        return " ".join(next_steps(RegistrationResult(status, "so it is", None, config=config)))

    assert "--gravity-aligned" in advised({})
    assert "--gravity-aligned" not in advised({known: True})
    assert "--prior-pose" in advised({known: True})
