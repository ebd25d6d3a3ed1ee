# SPDX-License-Identifier: BSD-3-Clause
"""The same recording in every container, written by the format's own library, is the same survey bit for bit."""

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.logs.read import list_topics
from magmatch.data.read import read_survey
from magmatch.data.tables.tum import write_tum


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


def test_every_container_gives_the_survey_of_the_csv_bit_for_bit_and_counts_the_same(
    container, made, flight, as_csv, tmp_path
):
    path = made.WRITERS[container](tmp_path, flight.series)
    survey = read_survey(path)
    for name in ("times", "positions", "field"):
        np.testing.assert_array_equal(getattr(survey, name), getattr(as_csv, name))
    np.testing.assert_array_equal(survey.orientations.as_quat(), as_csv.orientations.as_quat())
    assert (survey.frame, len(survey)) == ("map", 300)
    topics, _ = list_topics(path, SurveyFormat())
    assert [(topic.name, topic.count, topic.first_ns, topic.last_ns) for topic in topics] == [
        (series.topic, len(series.log_ns), series.log_ns[0], series.log_ns[-1]) for series in flight.series
    ]
    assert [topic.facts()["rate"] for topic in topics] == pytest.approx([50.0, 20.0], rel=1e-5)  # Hz
