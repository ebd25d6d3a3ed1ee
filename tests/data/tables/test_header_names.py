# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories are read by the names in their header, wherever it stands, or refused where it contradicts."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import load_trajectory
from magmatch.data.read import read_survey
from magmatch.errors import DataFormatError

N = 12
SECONDS = 1_700_000_000
POSITIONS = np.round(np.column_stack([np.arange(N) / 7, np.sin(np.arange(N)), np.arange(N) % 3 + 0.5]), 6)
TURNS = Rotation.from_rotvec(np.column_stack([0.1 * np.arange(N), np.full(N, 0.2), -0.05 * np.arange(N)]))
TRUE = {
    "t": [f"{SECONDS + i}.25" for i in range(N)],
    "ns": [f"{SECONDS + i}250000000" for i in range(N)],
    **{axis: [f"{v:.6f}" for v in POSITIONS[:, k]] for k, axis in enumerate("xyz")},
    **{f"q{axis}": [f"{v:.9f}" for v in TURNS.as_quat()[:, k]] for k, axis in enumerate("xyzw")},
    **{f"v{axis}": ["9"] * N for axis in "xyz"},
}


def write(path, header, order, mark):
    rows = [mark.join(cells) for cells in zip(*(TRUE[name] for name in order.split()), strict=True)]
    path.write_text("\n".join([header, *rows, ""]))
    return path


def expect_the_poses(trajectory):
    np.testing.assert_array_equal(trajectory.times, SECONDS + 0.25 + np.arange(N))
    np.testing.assert_array_equal(trajectory.positions, POSITIONS)
    np.testing.assert_allclose(trajectory.orientations.as_quat(), TURNS.as_quat(), atol=1e-8)


# Header, order of the columns under it, what separates them.
HEADERS = [
    ("# timestamp tx ty tz qw qx qy qz", "t x y z qw qx qy qz", " "),
    ("# ground truth trajectory\n# file: 'desk.bag'\n# timestamp tx ty tz qx qy qz qw", "t x y z qx qy qz qw", " "),
    ("#qw qx qy qz tx ty tz stamp", "qw qx qy qz x y z t", " "),
    ("# format: t, x, y, z, qw, qx, qy, qz", "t x y z qw qx qy qz", " "),
    ("# timestamp [s] p_x [m] p_y [m] p_z [m] q_w [] q_x [] q_y [] q_z []", "t x y z qw qx qy qz", " "),
    ("# time_s pos_x_m pos_y_m pos_z_m quat_w quat_x quat_y quat_z", "t x y z qw qx qy qz", " "),
    ("# timestamp [ns] tx ty tz qw qx qy qz", "ns x y z qw qx qy qz", " "),
    ("#timestamp [ns],p_x [m],p_y [m],p_z [m],q_x [],q_y [],q_z [],q_w []", "ns x y z qx qy qz qw", ","),
    ("#timestamp [ns],q_w [],q_x [],q_y [],q_z [],p_x [m],p_y [m],p_z [m]", "ns qw qx qy qz x y z", ","),
    ("#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x, "
     "v_RS_R_y, v_RS_R_z", "ns x y z qw qx qy qz vx vy vz", ","),
    ("#timestamp [s],tx,ty,tz,qx,qy,qz,qw", "t x y z qx qy qz qw", ","),
    ("# t,x,y,z,qw,qx,qy,qz", "t x y z qw qx qy qz", ","),
    ("t,x,y,z,qx,qy,qz,qw", "t x y z qx qy qz qw", ","),
    ("t x y z qx qy qz qw", "t x y z qx qy qz qw", " "),
    ("Timestamp;PosX;PosY;PosZ;QuatW;QuatX;QuatY;QuatZ", "t x y z qw qx qy qz", ";"),
    ("vx,vy,vz,header.stamp,pose.position.x,pose.position.y,pose.position.z,pose.orientation.x,pose.orientation.y,"
     "pose.orientation.z,pose.orientation.w", "vx vy vz t x y z qx qy qz qw", ","),
    ("timestamp [ns],p_x [m],p_y [m],p_z [m],q_x [],q_y [],q_z [],q_w []", "ns x y z qx qy qz qw", ","),
    ("sep=;\nt;x;y;z;qw;qx;qy;qz", "t x y z qw qx qy qz", ";"),
    ("t [s] x [m] y [m] z [m] q_w [] q_x [] q_y [] q_z []", "t x y z qw qx qy qz", " "),
    ("# poses of the phone", "t x y z qx qy qz qw", " "),
    ("# these are eight words of no special meaning", "t x y z qx qy qz qw", " "),
    ("#timestamp [ns], a, b, c, d, e, f, g", "ns x y z qw qx qy qz", ","),
    ("# time x y z x y z w", "t x y z qx qy qz qw", " "),
]  # fmt: skip


@pytest.mark.parametrize(("header", "order", "mark"), HEADERS, ids=[header[:60] for header, _, _ in HEADERS])
def test_poses_are_read_by_the_names_in_the_header(header, order, mark, tmp_path):
    expect_the_poses(load_trajectory(write(tmp_path / "poses.txt", header, order, mark), SurveyFormat()))


@pytest.mark.parametrize("decimal", [",", "."])
def test_a_table_of_poses_may_have_decimal_commas(decimal, tmp_path):
    for header, mark in (
        ("t;x;y;z;qw;qx;qy;qz", ";"),
        ("# t x y z qw qx qy qz", " "),
        ("# t x y z qw qx qy qz", ";"),
    ):
        path = write(tmp_path / "poses.csv", header, "t x y z qw qx qy qz", mark)
        path.write_text(path.read_text().replace(".", decimal))
        expect_the_poses(load_trajectory(path, SurveyFormat()))


CONTRADICTIONS = [
    ("# t x y z qw a b c", "t x y z qw qx qy qz", " ", "'qw' stands where qx is expected"),
    ("# time x y z q0 q1 q2 q3", "t x y z qw qx qy qz", " ", "'q0' stands where qx is expected"),
    ("# time x y z q[0] q[1] q[2] q[3]", "t x y z qw qx qy qz", " ", "'q[0]' stands where qx is expected"),
    ("# time x y z qr qi qj qk", "t x y z qw qx qy qz", " ", "'qr' stands where qx is expected"),
    ("# time x y z qw qx qy", "t x y z qw qx qy qz", " ", "'qw' stands where qx is expected"),
    ("# t z y x qx qy qz qw extra", "t z y x qx qy qz qw vx", " ", ""),
    ("# time x y z w x y z", "t x y z qw qx qy qz", " ", "'w' stands where qx is expected"),
    ("# time vx vy vz qx qy qz qw", "t vx vy vz qx qy qz qw", " ", "'vx' stands where x is expected"),
    ("t,x,y,z,roll,pitch,yaw", "t x y z qx qy qz", ",", "missing qx, qy, qz, qw; found t, x, y, z, roll"),
    ("t,x,y,z,qx,qy,qz,qw,time", "t x y z qx qy qz qw t", ",", "some are named twice"),
    ("# t [s] x [mm] y [mm] z [mm] qx qy qz qw", "t x y z qx qy qz qw", " ", "--length-unit mm"),
]


@pytest.mark.parametrize(("header", "order", "mark", "words"), CONTRADICTIONS)
def test_names_that_contradict_the_usual_order_are_refused_or_followed(header, order, mark, words, tmp_path):
    path = write(tmp_path / "poses.txt", header, order, mark)
    if not words:
        expect_the_poses(load_trajectory(path, SurveyFormat()))
        return
    with pytest.raises(DataFormatError) as caught:
        load_trajectory(path, SurveyFormat())
    assert words in str(caught.value)


FIELDS = [
    ("#timestamp [ns],b_z [uT],b_y [uT],b_x [uT]", "{t},{z},{y},{x}"),
    ("#timestamp [ns],a_x,a_y,a_z,m_x,m_y,m_z", "{t},1,2,3,{x},{y},{z}"),
    ("#timestamp [ns],x,y,z,mag_x,mag_y,mag_z", "{t},1,2,3,{x},{y},{z}"),
    ("#timestamp [ns],x [uT],y [uT],z [uT]", "{t},{x},{y},{z}"),
    ("#timestamp [ns],z,y,x", "{t},{z},{y},{x}"),
    ("#timestamp [s],magX,magY,magZ", "{s},{x},{y},{z}"),
]


@pytest.mark.parametrize(("header", "row"), FIELDS)
def test_a_magnetometer_is_read_by_the_names_in_its_header(header, row, tmp_path):
    field = np.column_stack([np.arange(N) + 20.5, np.arange(N) % 4, np.arange(N) - 45.25])
    cells = [row.format(t=TRUE["ns"][i], s=TRUE["t"][i], x=x, y=y, z=z) for i, (x, y, z) in enumerate(field.tolist())]
    (tmp_path / "mag.csv").write_text("\n".join([header, *cells, ""]))
    poses = write(tmp_path / "poses.txt", "# t x y z qx qy qz qw", "t x y z qx qy qz qw", " ")
    layout = SurveyFormat(field_unit="uT", field_frame="survey", trajectory=poses)
    np.testing.assert_allclose(read_survey(tmp_path / "mag.csv", layout).field, field * 1e-6, rtol=1e-14)
    # Unless it is said otherwise, the sensor turns with the body.
    turned = read_survey(tmp_path / "mag.csv", SurveyFormat(field_unit="uT", trajectory=poses)).field
    np.testing.assert_allclose(turned, TURNS.apply(field * 1e-6), rtol=1e-7)


def test_a_magnetometer_whose_names_are_others_is_refused(tmp_path):
    (tmp_path / "mag.csv").write_text("#timestamp [ns],a_x,a_y,a_z\n1700000000000000000,1,2,3\n")
    poses = write(tmp_path / "poses.txt", "", "t x y z qx qy qz qw", " ")
    with pytest.raises(DataFormatError, match="'a_x' stands where bx is expected"):
        read_survey(tmp_path / "mag.csv", SurveyFormat(trajectory=poses))


def test_a_phone_log_whose_header_names_another_order_is_refused(tmp_path):
    head = "% LogFile created by the 'GetSensorData' App\n% 'MAGN;AppTimestamp(s);SensorTimestamp(s);Mag_{}(uT);{}'\n"
    rows = "".join(f"MAGN;{i / 10};{5 + i / 10};20;3;-45;3\n" for i in range(N))
    poses = write(tmp_path / "poses.txt", "", "t x y z qx qy qz qw", " ")
    layout = SurveyFormat(trajectory=poses)
    for names, words in (("YXZ", "found the columns AppTimestamp"), ("XYZ", "same clock")):
        header = head.format(names[0], f";Mag_{names[1]}(uT);Mag_{names[2]}(uT);Accuracy(integer)")
        (tmp_path / "log.txt").write_text(header + rows)
        with pytest.raises(DataFormatError, match=words):
            read_survey(tmp_path / "log.txt", layout)
