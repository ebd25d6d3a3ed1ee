# SPDX-License-Identifier: BSD-3-Clause
"""What a console shows of an object is a line or three, however many numbers the object holds."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm
from magmatch.features.extract import Features
from magmatch.field.values import FieldValues
from magmatch.localization.estimate import LocalizerStatus, PoseEstimate
from magmatch.localization.result import LocalizationResult, LocalizationStatus
from magmatch.localization.track import Track
from magmatch.slam.result import ClosureResult, LogResult, SlamResult, SlamStatus

N = 1000
RNG = np.random.default_rng(0)
POINTS, FIELD = RNG.uniform(0, 3, (N, 3)), RNG.normal([2e-5, 0, -4e-5], 1e-6, (N, 3))
WALK = mm.Survey(POINTS, FIELD, np.arange(N) * 0.1, Rotation.random(N, rng=0), name="walk")
LOST = PoseEstimate(LocalizerStatus.LOST, "so it is " * 40, np.eye(4), np.eye(6), 0.9, np.zeros(3), np.ones(3), 1.0)
CLOSURE = ClosureResult("a", 0.0, "b", 1.0, RigidTransform.identity(), np.eye(6), 0.99, 1.0)
NOUNS = {
    "Survey": WALK,
    "Trajectory": mm.Trajectory(np.arange(N), POINTS, Rotation.random(N, rng=0)),
    "Features": Features(POINTS, FIELD, np.ones(N), Rotation.random(N, rng=0), np.ones((N, 64))),
    "no Features": Features.empty(64),
    "FieldValues": FieldValues(FIELD, np.zeros((N, 3, 3))),
    "PoseEstimate": LOST,
    "Track": Track(WALK, (), [LOST] * N, mm.LocalizerConfig(), {"total": 1.0}),
    "LocalizationResult": LocalizationResult(LocalizationStatus.NEVER, "so it is " * 40, config={"a": [1] * N}),
    "ClosureResult": CLOSURE,
    "SlamResult": SlamResult(SlamStatus.CONNECTED, "all", (LogResult("a", 0, None, 1.0, 1, 0.0, (1.0, 0.1)),) * 50),
    "Session": mm.Session(given=[WALK] * 50),
    "Atlas": mm.Atlas(Path("maps"), (), mm.RegistrationConfig()),
}


@pytest.mark.parametrize("name", NOUNS)
def test_an_object_shows_itself_in_three_lines_or_fewer(name):
    said = repr(NOUNS[name])
    assert name.split()[-1] in said
    assert len(said.splitlines()) <= 3
    assert len(said) < 500
