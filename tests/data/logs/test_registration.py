# SPDX-License-Identifier: BSD-3-Clause
"""The same recording as CSV, Parquet, bag and MCAP gives the same registration, bit for bit."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.fingerprint import hash_survey
from magmatch.data.read import read_survey
from magmatch.data.survey import Survey
from magmatch.data.write import SURVEY_WRITERS
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch.registration.register import register
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate


@pytest.fixture(scope="module")
def pair():
    """A small pair; the target has whole nanoseconds and orientations, as a log has."""
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    made = simulate("office", 1, SimulationConfig(n_samples=80, room_size=(1.5, 1.5, 0.6)))
    target, n = made.target, len(made.target)
    stamps = [1_700_000_000_000_000_000 + 20_000_000 * i for i in range(n)]
    turns = Rotation.random(n, rng=np.random.default_rng(0))
    times = np.array([stamp / 10**9 for stamp in stamps])
    return made.base, Survey(target.positions, target.field, times, turns, frame="target")


@pytest.fixture
def files(pair, made, tmp_path):
    """The target in every format."""
    _, target = pair
    for ending in (".csv", ".parquet", ".mcap"):
        SURVEY_WRITERS[ending](target, tmp_path / f"target{ending}")
    ns = np.array([round(t * 1e9) for t in target.times.tolist()], dtype=np.int64)
    poses = np.hstack([target.positions, target.orientations.as_quat()])
    series = [
        made.Series("/mag", "sensor_msgs/msg/MagneticField", ns, target.field, frame="target"),
        made.Series("/pose", "geometry_msgs/msg/PoseStamped", ns, poses, frame="target"),
    ]
    made.ros1(tmp_path / "target.bag", series)
    made.ros2(tmp_path / "target-db3", series)
    made.ros2(tmp_path / "target-mcap", series, "mcap")
    return tmp_path


@pytest.mark.slow
def test_every_format_gives_the_same_registration(pair, files):
    names = ["target.csv", "target.parquet", "target.mcap", "target.bag", "target-db3", "target-mcap"]
    surveys = {name: read_survey(files / name) for name in names}
    assert len({hash_survey(survey) for survey in surveys.values()}) == 1
    base = build_map(pair[0], SPLINE)
    first, second = (register(base, surveys[name]) for name in ("target.csv", "target.bag"))
    assert first.status == second.status
    poses = [r.alternatives[0].T_base_target if r.T_base_target is None else r.T_base_target for r in (first, second)]
    np.testing.assert_array_equal(poses[0].as_matrix(), poses[1].as_matrix())
    np.testing.assert_array_equal(first.covariance, second.covariance)
