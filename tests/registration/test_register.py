# SPDX-License-Identifier: BSD-3-Clause
"""What `register` hands to its parts."""

import numpy as np
import pytest

from magmatch.field.build import build_map
from magmatch.field.map import FieldMap
from magmatch.registration import register as module
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.result import RegistrationResult, Status
from magmatch.simulation.simulate import simulate


@pytest.mark.parametrize("is_mapped", [False, True])
def test_a_walk_is_compared_with_every_sample_that_was_given(monkeypatch, is_mapped):
    pair, seen = simulate("corridor", 0), []

    def half_of(survey, config):
        """A map leaves out what contradicts the rest: here every other sample."""
        if isinstance(survey, FieldMap):
            return survey
        return build_map(survey.subset(np.arange(0, len(survey), 2)), config.field)

    def refuse(_walks, survey, *_):
        seen.append(len(survey))
        return RegistrationResult(status=Status.NO_OVERLAP, reason="a stand-in", T_base_target=None)

    monkeypatch.setattr(module, "as_map", half_of)
    monkeypatch.setattr(module, "index_base", lambda *_: None)
    monkeypatch.setattr(module, "register_walk", refuse)
    monkeypatch.setattr(module, "settle_walk", lambda _walks, _target, answer, *_: answer)
    base = build_map(pair.base) if is_mapped else pair.base
    module.register(base, pair.target, RegistrationConfig(search="pairs"))
    assert seen == [len(pair.target)]
