# SPDX-License-Identifier: BSD-3-Clause
"""Currents and other numbers of a log stand beside the samples at their times, whatever the container."""

import json
import struct

import numpy as np
import pytest

from magmatch.data.format import SurveyFormat
from magmatch.data.logs.log import Batch, Channel
from magmatch.data.logs.numbers import decoded, read_numbers
from magmatch.data.logs.open import open_log
from magmatch.data.read import read_survey, read_survey_and_channels

SECOND = 1_000_000_000
DELAY = 40_000_000  # ns by which messages reach the recorder late
BATTERY, JOINTS = "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/JointState"
VALUE, MANY = "std_msgs/msg/Float64", "std_msgs/msg/Float32MultiArray"


def current(t):
    return 3.0 + np.sin(np.asarray(t))


def others(messages, stamp, t):
    """One message of each type at a time: (topic, type, message)."""
    types, header = messages.store.types, messages.header(stamp, "base")
    now, none = float(current(t)), np.zeros(0, np.float32)
    battery = types[BATTERY](
        header=header, voltage=24.0, temperature=20.0, current=now, charge=1.0, capacity=2.0,
        design_capacity=3.0, percentage=0.5, power_supply_status=1, power_supply_health=1, power_supply_technology=1,
        present=True, cell_voltage=np.full(6, 4.0, np.float32), cell_temperature=none, location="slot",
        serial_number="7",
    )  # fmt: skip
    joints = types[JOINTS](
        header=header, name=["left", "right_wheel"], position=np.zeros(2), velocity=np.zeros(0),
        effort=np.array([now, -now]),
    )  # fmt: skip
    dimension = types["std_msgs/msg/MultiArrayDimension"](label="motor", size=2, stride=2)
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[dimension], data_offset=0)
    array = types[MANY](layout=layout, data=np.array([now, 2 * now], np.float32))
    value = types[VALUE](data=now)
    return [("/battery", BATTERY, battery), ("/joints", JOINTS, joints), ("/motors", MANY, array),
            ("/amps", VALUE, value)]  # fmt: skip


def write_mcap(path, made, flight):
    """The flight and four other topics at 10 Hz, logged late."""
    from mcap.writer import Writer

    messages = made.Messages(2)
    late = [made.replace(s, log_ns=s.log_ns + DELAY, stamp_ns=s.log_ns) for s in flight.series]
    rows = [(int(s.log_ns[i]), s.topic, s.type, messages.build(s, i)) for s in late for i in range(len(s.log_ns))]
    for stamp in range(flight.mag_ns[0] - SECOND, flight.mag_ns[-1] + SECOND, SECOND // 10):
        t = (stamp - flight.mag_ns[0]) / SECOND
        rows += [(stamp + DELAY, *other) for other in others(messages, stamp, t)]
    with path.open("wb") as stream:
        writer, channels = Writer(stream), {}
        writer.start()
        for log_ns, topic, kind, message in sorted(rows, key=lambda row: row[0]):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", b""))
            writer.add_message(channels[topic], log_ns, messages.serialise(message, kind), log_ns)
        writer.finish()
    return path


def write_bag(path, made, flight):
    """The same as a ROS 1 bag."""
    from rosbags.rosbag1 import Writer

    messages = made.Messages(1)
    late = [made.replace(s, log_ns=s.log_ns + DELAY, stamp_ns=s.log_ns) for s in flight.series]
    with Writer(path) as writer:
        opened = {}

        def write(log_ns, topic, kind, message):
            if topic not in opened:
                opened[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            writer.write(opened[topic], log_ns, bytes(messages.serialise(message, kind)))

        for s in late:
            for i, log_ns in enumerate(s.log_ns.tolist()):
                write(log_ns, s.topic, s.type, messages.build(s, i))
        for stamp in range(flight.mag_ns[0] - SECOND, flight.mag_ns[-1] + SECOND, SECOND // 10):
            for other in others(messages, stamp, (stamp - flight.mag_ns[0]) / SECOND):
                write(stamp + DELAY, *other)
    return path


@pytest.mark.parametrize("write", [write_mcap, write_bag])
def test_other_numbers_stand_at_the_times_of_the_samples(write, made, flight, tmp_path):
    path = write(tmp_path / "log", made, flight)
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
        np.testing.assert_allclose(channels[name], factor * expected, rtol=0, atol=2e-2 * abs(factor))  # at 10 Hz
    # 40 ms later they would be off by four times as much as interpolation is.
    assert np.abs(channels["/amps"] - expected).max() < 0.3 * np.abs(current(survey.times) - expected).max()


def test_the_battery_of_older_robots_is_read_too():
    """ROS 1 had no temperature in it before 2019."""
    head = struct.pack("<III", 1, 2, 3) + struct.pack("<I", 4) + b"base"
    body = struct.pack("<6f", 24.0, 3.5, 1.0, 2.0, 3.0, 0.5) + bytes(4) + struct.pack("<I2f", 2, 4.0, 4.0)
    raw = head + body + bytes(8)
    batch = Batch(Channel("/battery", "sensor_msgs/BatteryState", "ros1"), [5], [raw])
    ((numbers, n_bad),) = decoded(batch)
    assert n_bad == 0
    assert numbers["current"][1].tolist() == [3.5]


def test_numbers_written_as_json_are_read(tmp_path):
    writers = pytest.importorskip("mcap.writer")
    path = tmp_path / "log.mcap"
    contents = {"/amps": ("std_msgs/Float64", [{"data": 2.5}, {"data": "x"}, {}, [], {"data": 3.5}]),
                "/battery": (BATTERY, [{"current": 1.5}, {"current": None}]),
                "/joints": (JOINTS, [{"name": ["a"], "effort": [4.0]}])}  # fmt: skip
    with path.open("wb") as stream:
        writer = writers.Writer(stream)
        writer.start()
        for topic, (kind, messages) in contents.items():
            channel = writer.register_channel(topic, "json", writer.register_schema(kind, "jsonschema", b"{}"))
            for i, content in enumerate(messages):
                writer.add_message(channel, i, json.dumps(content).encode(), i)
        writer.finish()
    log = open_log(path)
    found = read_numbers(log, log.topics(), 0.0).by_name
    log.close()
    assert {name: channel.values.tolist() for name, channel in found.items()} == {
        "/amps": [2.5, 3.5], "/battery current": [1.5], "/joints effort a": [4.0],
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
