# SPDX-License-Identifier: BSD-3-Clause
"""A place whose field is known, its map, and a walk in it by odometry that drifts."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from drifting import Place, drifting_walk
from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch.localization.known_map import KnownMap
from magmatch.localization.localize import localize
from magmatch.registration.index.map_index import prepare_index


@pytest.fixture(scope="session")
def place():
    """An indexed map, made at true positions."""
    _, truth = drifting_walk(Place(1), 7, laps=4.0)
    noise = 2e-7 * np.random.default_rng(7).standard_normal(truth.shape)
    field_map = build_map(Survey(truth, Place(1).field(truth) + noise, name="place"), SPLINE)
    return prepare_index(field_map)


@pytest.fixture(scope="session")
def known(place):
    """The same, ready to be localised in."""
    return KnownMap.of(place)


@pytest.fixture(scope="session")
def followed(place):
    """A walk of which only its odometry's frame is known, followed."""
    log, truth = drifting_walk(Place(1), 3, laps=1.5, start=1.0, bias=(2e-6, -1e-6, 1e-6))
    return SimpleNamespace(log=log, truth=truth, track=localize(place, log, live=True))


@pytest.fixture(scope="session")
def feed():
    """Hands samples of a log to a localizer, the odometry's frame moved by T; gives the estimate after each."""

    def fed(localizer, log, rows=slice(None), T=None, later=0.0):
        R = log.orientations
        poses, field = RigidTransform.from_components(log.positions, R), R.inv().apply(log.field)
        for n in range(len(log))[rows]:
            localizer.update(float(log.times[n]) + later, poses[n] if T is None else T * poses[n], field[n])
            yield localizer.estimate()

    return lambda *given, **more: list(fed(*given, **more))
