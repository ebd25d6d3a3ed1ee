# SPDX-License-Identifier: BSD-3-Clause
"""What must not change the survey in a log, and what each clock, frame and byte order must give."""

import gzip
import itertools
import struct
from contextlib import nullcontext

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.errors import DataFormatError

TF, POSE = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/PoseStamped"


def poses_of(values):
    return RigidTransform.from_components(values[:, :3], Rotation.from_quat(values[:, 3:]))


def values_of(T):
    return np.hstack([T.translation, T.rotation.as_quat()])


def reverse(made, series):
    """The same edge from child to parent."""
    inverse = values_of(poses_of(series.values).inv())
    return made.replace(series, frame=series.child, child=series.frame, values=inverse)


def close(survey, expected):
    np.testing.assert_array_equal(survey.times, expected.times)
    np.testing.assert_allclose(survey.positions, expected.positions, rtol=0, atol=1e-13)  # m, of some metres
    np.testing.assert_allclose(survey.field, expected.field, rtol=0, atol=1e-19)  # T, of 5e-5


@pytest.fixture
def chain(made, flight):
    """Sensor in map over two edges that move, stamped together, and two that do not."""
    odom = flight.series[1]
    rng = np.random.default_rng(5)
    still = np.hstack([rng.normal(0, 0.3, (2, 3)), Rotation.random(2, rng=rng).as_quat()])
    drift = np.hstack([0.01 * np.arange(130)[:, None] * [1.0, -2.0, 0.5], np.tile([0.0, 0.48, 0.6, 0.64], (130, 1))])
    return [
        made.Series("/tf", TF, odom.log_ns, drift, frame="map", child="odom"),
        made.Series("/tf", TF, odom.log_ns, odom.values, frame="odom", child="base"),
        made.Series("/tf_static", TF, odom.log_ns[:1], still[:1], frame="base", child="mast"),
        made.Series("/tf_static", TF, odom.log_ns[:1], still[1:], frame="mast", child="mag_link"),
    ]


LAYOUT = SurveyFormat(pose_frames="map,mag_link")


def test_poses_are_the_product_of_the_chain(made, flight, chain, tmp_path):
    survey = read_survey(made.mcap(tmp_path / "log.mcap", [flight.series[0], *chain]), LAYOUT)
    drift, odom, mast, link = (poses_of(series.values) for series in chain)
    product = values_of(drift * odom * mast[0] * link[0])
    pose = made.Series("/pose", POSE, flight.pose_ns, product)
    close(survey, read_survey(made.mcap(tmp_path / "pose.mcap", [flight.series[0], pose])))


@pytest.mark.parametrize("turned", [c for n in (1, 2, 4) for c in itertools.combinations(range(4), n)][::2])
def test_an_edge_reversed_with_its_transform_inverted_changes_nothing(turned, made, flight, chain, tmp_path):
    mag = flight.series[0]
    expected = read_survey(made.mcap(tmp_path / "log.mcap", [mag, *chain]), LAYOUT)
    other = [reverse(made, edge) if k in turned else edge for k, edge in enumerate(chain)]
    close(read_survey(made.mcap(tmp_path / "other.mcap", [mag, *other]), LAYOUT), expected)


def test_simulated_clocks_begin_at_zero(made, flight, tmp_path, caplog):
    """A stamp of zero is one where the message was logged at zero; elsewhere it is none, and left out."""
    mag, odom = flight.series
    mag = made.replace(mag, log_ns=10_000_000 * np.arange(300), stamp_ns=None)
    odom = made.replace(odom, log_ns=odom.log_ns - odom.log_ns[0], stamp_ns=None)
    survey = read_survey(made.mcap(tmp_path / "log.mcap", [mag, odom]))
    assert (len(survey), survey.times[0]) == (300, 0.0)
    stamps = mag.stamp_ns.copy()
    stamps[40] = 0
    survey = read_survey(made.mcap(tmp_path / "gap.mcap", [made.replace(mag, stamp_ns=stamps), odom]))
    assert (len(survey), survey.times[0]) == (299, 0.0)
    assert "left out 1 messages of /imu/mag without a stamp" in caplog.text


def test_seconds_of_ros1_have_no_sign(made, flight, tmp_path):
    """They reach the year 2106; those of ROS 2 end in 2038."""
    raw = made.ros1(tmp_path / "log.bag", flight.series).read_bytes()
    for second in range(1_699_999_990, 1_700_000_030):
        raw = raw.replace(struct.pack("<I", second), struct.pack("<I", second + 800_000_000))
    (tmp_path / "later.bag").write_bytes(raw)
    survey = read_survey(tmp_path / "later.bag")
    expected = read_survey(tmp_path / "log.bag")
    np.testing.assert_allclose(survey.times - expected.times, 8e8, rtol=0, atol=1e-6)


def test_quaternions_may_be_rounded_and_no_more(made, flight, tmp_path):
    mag, odom = flight.series
    for factor in (0.94, 0.96, 1.04, 1.06):
        values = odom.values * [1.0, 1, 1, factor, factor, factor, factor]
        path = made.mcap(tmp_path / "log.mcap", [mag, made.replace(odom, values=values)])
        is_refused = abs(factor - 1) > 0.05
        with pytest.raises(DataFormatError, match="a unit quaternion") if is_refused else nullcontext():
            assert len(read_survey(path)) == 300


def test_warnings_about_a_packed_log_name_the_file_itself(made, flight, tmp_path, caplog):
    frame = [made.replace(flight.series[0], frame="elsewhere"), flight.series[1]]
    path = made.mcap(tmp_path / "drive.mcap", frame)
    path.write_bytes(gzip.compress(path.read_bytes()))
    read_survey(path, SurveyFormat(field_frame="sensor"))
    told = [message for message in caplog.messages if "nothing says where 'elsewhere' sits" in message]
    assert [message.startswith(f"{path}: ") for message in told] == [True]


def test_a_message_at_fault_is_named_by_its_number_in_the_topic(made, flight, tmp_path):
    """Also behind the first batches that are decoded together."""
    mag, odom = flight.series
    n = 17_000
    values = np.tile(mag.values[:1], (n, 1))
    values[16_500] = np.nan
    many = made.replace(mag, log_ns=mag.log_ns[0] + np.arange(n) * 500_000, stamp_ns=None, values=values)
    with pytest.raises(DataFormatError, match="/imu/mag, message 16500: holds NaN"):
        read_survey(made.mcap(tmp_path / "log.mcap", [many, odom]))
