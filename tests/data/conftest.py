# SPDX-License-Identifier: BSD-3-Clause
"""Small surveys and the real recordings, where they are present."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey

RECORDINGS = Path(__file__).parents[2] / "../shared/data"


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def room(rng):
    """Fifty samples of a smooth field in a room, with times and orientations."""
    n = 50
    positions = rng.uniform(0.0, 3.0, (n, 3))
    field = np.array([18e-6, 3e-6, -45e-6]) + 2e-6 * np.sin(positions)
    return Survey(positions, field, 0.5 * np.arange(n), Rotation.random(n, rng=rng), name="room")


@pytest.fixture
def zipped():
    """Write an archive of some members by name, and give its path."""

    def write(path, members):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in members.items():
                archive.writestr(name, content)
        return path

    return write


@pytest.fixture
def recordings():
    """Folder of the real recordings."""
    if not RECORDINGS.is_dir():
        pytest.skip("no recordings in ../shared/data beside the checkout")
    return RECORDINGS


@pytest.fixture
def walk():
    """Six hundred samples along a path, without orientations."""
    t = 100 + 0.5 * np.arange(600)
    field = np.random.default_rng(0).normal([2e-5, 0, -4e-5], 1e-6, (600, 3))
    return Survey(np.column_stack([0.3 * t, np.sin(t), 0 * t]), field, t)
