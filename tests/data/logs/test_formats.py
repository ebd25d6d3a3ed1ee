# SPDX-License-Identifier: BSD-3-Clause
"""The same recording in every container, written by the format's own library, is the same survey bit for bit."""

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.data.tables.tum import write_tum

FORMATS = [
    "ROS 1 bag", "ROS 1 bag, bz2", "ROS 1 bag, lz4", "ROS 2 bag, sqlite3", "ROS 2 bag, messages compressed",
    "ROS 2 bag, mcap", "MCAP of ROS 2", "MCAP of ROS 1", "MCAP of JSON", "MCAP, lz4", "MCAP, not compressed",
    "MCAP without chunks", "MCAP without summary",
]  # fmt: skip


def same(first, second):
    np.testing.assert_array_equal(first.times, second.times)
    np.testing.assert_array_equal(first.positions, second.positions)
    np.testing.assert_array_equal(first.field, second.field)
    np.testing.assert_array_equal(first.orientations.as_quat(), second.orientations.as_quat())


@pytest.fixture
def as_csv(flight, tmp_path):
    """The recording as a CSV with whole nanoseconds in 17 digits or more, and a TUM file."""
    lines = [
        f"{t // 10**9}.{t % 10**9:09d}," + ",".join(f"{v:.17g}" for v in row)
        for t, row in zip(flight.mag_ns.tolist(), flight.mag, strict=True)
    ]
    (tmp_path / "field.csv").write_text("t,bx,by,bz\n" + "\n".join(lines) + "\n")
    times, poses = flight.trajectory().times, flight.poses
    write_tum(tmp_path / "poses.tum", times, poses[:, :3], poses[:, 3:])
    return read_survey(tmp_path / "field.csv", SurveyFormat(trajectory=tmp_path / "poses.tum", field_frame="sensor"))


@pytest.mark.parametrize("name", FORMATS)
def test_every_container_gives_the_survey_of_the_csv_bit_for_bit(name, made, flight, as_csv, tmp_path):
    survey = read_survey(made.WRITERS[name](tmp_path, flight.series))
    same(survey, as_csv)
    assert survey.frame == "map"
    assert len(survey) == 300
