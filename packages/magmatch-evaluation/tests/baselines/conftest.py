# SPDX-License-Identifier: BSD-3-Clause
"""One map of a small room; a map carried to another frame is the easiest target there is."""

import pytest

from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch.field.map import FieldMap
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate


@pytest.fixture(scope="session")
def room() -> FieldMap:
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    return build_map(simulate("office", 2, SimulationConfig(n_samples=700)).base, SPLINE)
