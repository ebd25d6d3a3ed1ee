# SPDX-License-Identifier: BSD-3-Clause
"""Currents and other numbers of a log stand beside the samples at their times, whatever the container."""

import json
import struct

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.logs.number_topics import read_numbers
from magmatch.data.logs.open import open_log
from magmatch.data.read import read_survey, read_survey_and_channels

SECOND = 1_000_000_000
DELAY = 40_000_000  # ns by which messages reach the recorder late


def current(t):
    return 3.0 + np.sin(np.asarray(t))


CONTAINERS = [
    "ROS 1 bag", "ROS 2 bag, sqlite3", "ROS 2 bag, messages compressed", "MCAP of ROS 2", "MCAP of ROS 1",
    "MCAP without summary",
]  # fmt: skip


@pytest.mark.parametrize("container", CONTAINERS)
def test_other_numbers_stand_at_the_times_of_the_samples(container, made, flight, tmp_path):
    late = [made.replace(s, log_ns=s.log_ns + DELAY, stamp_ns=s.log_ns) for s in flight.series]
    stamps = np.arange(flight.mag_ns[0] - SECOND, flight.mag_ns[-1] + SECOND, SECOND // 10)
    amps = current((stamps - flight.mag_ns[0]) / SECOND)
    others = [made.Series(topic, kind, stamps + DELAY, amps, "base") for topic, kind in made.numbers.items()]
    path = made.WRITERS[container](tmp_path, [*late, *others])
    survey, channels = read_survey_and_channels(path)
    np.testing.assert_array_equal(survey.field, read_survey(path).field)
    assert sorted(channels) == [
        "/amps", "/battery current", "/joints effort left", "/joints effort right_wheel", "/motors [0]",
        "/motors [1]",
    ]  # fmt: skip
    expected = current(survey.times - flight.mag_ns[0] / SECOND)
    for name, factor in {
        "/amps": 1,
        "/battery current": 1,
        "/joints effort right_wheel": -1,
        "/motors [1]": 2,
    }.items():
        # Interpolated at 10 Hz; 40 ms of delay would be ten times as much.
        np.testing.assert_allclose(channels[name], factor * expected, rtol=0, atol=4e-3 * abs(factor))


def numbers_of(path, encoding, contents):
    """What is read of messages written as they stand: by topic, their type and payloads."""
    writers = pytest.importorskip("mcap.writer")
    with path.open("wb") as stream:
        writer = writers.Writer(stream)
        writer.start()
        for topic, (kind, payloads) in contents.items():
            channel = writer.register_channel(topic, encoding, writer.register_schema(kind, "", b""))
            for i, payload in enumerate(payloads):
                writer.add_message(channel, i, payload, i)
        writer.finish()
    log = open_log(path)
    found = read_numbers(log, log.topics(), 0.0)
    log.close()
    return {name: channel.values.tolist() for name, channel in found.items()}


def test_the_battery_of_older_robots_is_read_too(tmp_path):
    """ROS 1 had no temperature in it before 2019."""
    head = struct.pack("<III", 1, 2, 3) + struct.pack("<I", 4) + b"base"
    body = struct.pack("<6f", 24.0, 3.5, 1.0, 2.0, 3.0, 0.5) + bytes(4) + struct.pack("<I2f", 2, 4.0, 4.0)
    contents = {"/battery": ("sensor_msgs/BatteryState", [head + body + bytes(8)])}
    assert numbers_of(tmp_path / "log.mcap", "ros1", contents) == {"/battery current": [3.5]}


def test_numbers_written_as_json_are_read(tmp_path):
    contents = {"/amps": ("std_msgs/Float64", [{"data": 2.5}, {"data": "x"}, {}, [], {"data": 3.5}]),
                "/battery": ("sensor_msgs/BatteryState", [{"current": 1.5}, {"current": None}]),
                "/motors": ("std_msgs/Float32MultiArray", [{"data": [1.0, None]}, {"data": [None, 2.0]}]),
                "/joints": ("sensor_msgs/JointState", [{"name": ["a"], "effort": [4.0]}])}  # fmt: skip
    written = {t: (kind, [json.dumps(content).encode() for content in c]) for t, (kind, c) in contents.items()}
    assert numbers_of(tmp_path / "log.mcap", "json", written) == {
        "/amps": [2.5, 3.5], "/battery current": [1.5], "/joints effort a": [4.0],
        "/motors [0]": [1.0], "/motors [1]": [2.0],
    }  # fmt: skip


def test_columns_of_parquet_and_renamed_ones_are_channels(room, tmp_path):
    pq, pa = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow")
    own = dict(zip(("x", "y", "z"), room.positions.T, strict=True))
    own |= dict(zip(("mag_x", "by", "bz"), room.field.T, strict=True))
    amps = np.arange(float(len(room)))
    table = own | {"stamp": room.times * 1e3, "amps": amps, "state": ["a"] * len(room), "holes": [None] * len(room)}
    pq.write_table(pa.table(table), tmp_path / "room.parquet")
    rows = [",".join(map(repr, row)) for row in zip(*(np.asarray(own[k]).tolist() for k in own), strict=True)]
    stamps = (room.times * 1e3).tolist()
    text = [f"{row},{t!r},{k},a" for k, (row, t) in enumerate(zip(rows, stamps, strict=True))]
    (tmp_path / "room.csv").write_text("\n".join([",".join(own) + ",stamp,amps,state", *text]))
    layout = SurveyFormat(columns="bx=mag_x,t=stamp", time_unit="ms")
    for name in ("room.parquet", "room.csv"):
        survey, channels = read_survey_and_channels(tmp_path / name, layout)
        assert list(channels) == ["amps"], name
        np.testing.assert_allclose(channels["amps"], amps, atol=1e-6)
        np.testing.assert_allclose(survey.times, room.times)
