# SPDX-License-Identifier: BSD-3-Clause
"""A map, walks in it, and a service of it that most tests share."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import settings

from drifting import Place, drifting_walk
from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch_serve.serve import prepare_once
from serving import serving

# As in the tests of the package.
settings.register_profile("same", derandomize=True)
settings.load_profile("same")


@pytest.fixture(scope="session")
def hall(tmp_path_factory):
    """A saved map with its index, and walks through it: logs and true positions by seed."""
    folder = tmp_path_factory.mktemp("hall")
    _, truth = drifting_walk(Place(1), 7, laps=4.0)
    noise = 2e-7 * np.random.default_rng(7).standard_normal(truth.shape)
    build_map(Survey(truth, Place(1).field(truth) + noise, name="hall"), SPLINE).save(folder / "hall.map")
    # As the first service of it leaves it, and every process that is started finds it.
    prepare_once(folder / "hall.map")

    def walk(seed, laps=0.5):
        return drifting_walk(Place(1), seed, laps=laps, start=float(seed), bias=(2e-6, -1e-6, 1e-6))

    return SimpleNamespace(folder=folder, map=folder / "hall.map", walk=walk)


@pytest.fixture(scope="session")
def limits(hall):
    """Settings that make limits cheap to reach."""
    path = hall.folder / "limits.yaml"
    path.write_text(
        "trackers: 2\nmax_clients: 8\nmax_body: 200000\nmax_unpacked: 400000\nmax_log: 1500\nmax_mistakes: 20\n"
        "max_rate: 2000\nmax_samples: 50\ncheckpoint_every: 0.5\nmax_requests: 100000\nmax_connects: 100000\n"
        "patience: 3\nmax_upload_time: 5\n"
    )
    return path


@pytest.fixture(scope="session")
def door(hall, limits):
    """A running service."""
    with serving(hall.map, "--config", limits) as service:
        yield service
