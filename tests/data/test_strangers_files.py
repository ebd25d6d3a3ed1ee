# SPDX-License-Identifier: BSD-3-Clause
"""Files as other programs write them, with marks, dates and names of their own: read, or refused with advice."""

import codecs

import numpy as np
import pytest

from magmatch.cli.main import main
from magmatch.data.formats.csv import read_points
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.errors import DataFormatError
from magmatch.slam.graph.anchors import read_anchors

N = 20
TIMES = np.arange(N) / 10
FIELD = np.column_stack([20 + TIMES, -3 + TIMES, -40 - TIMES])
STAMPS = 1_700_000_000_000 + 100 * np.arange(N)  # ms
NAMES = "t,x,y,z,bx,by,bz"


@pytest.fixture
def poses(tmp_path):
    path = tmp_path / "poses.tum"

    def write(start):
        rows = [f"{start + k / 2!r} {k} {k * k % 3} {k % 2} 0 0 0 1" for k in range(-2, 8)]
        path.write_text("\n".join(rows))
        return SurveyFormat(trajectory=path)

    return write


def get_sensor_data():
    rows = zip(TIMES.tolist(), FIELD.tolist(), strict=True)
    return "% Log\n" + "".join(f"MAGN;{t};{t};{x:.3f};{y:.3f};{z:.4f};3\n" for t, (x, y, z) in rows)


def xyz10():
    rows = zip(STAMPS.tolist(), FIELD.tolist(), strict=True)
    return "# Log\n" + "".join(f"{t}\tTYPE_MAGNETIC_FIELD\t{x}\t{y:.3f}\t{z:.3f}\t3\n" for t, (x, y, z) in rows)


TEXT_LOGS = {"GetSensorData": (get_sensor_data, 0), "XYZ10": (xyz10, 1_700_000_000)}
EDITED = {
    "typographic minus": lambda text: text.replace("-", "\u2212").encode(),
    "byte order mark": lambda text: codecs.BOM_UTF8 + text.replace("\n", "\r\n").encode(),
    "a header in Latin-1": lambda text: text.replace("Log", "Gerät", 1).encode("latin-1"),
}


@pytest.mark.parametrize("edit", EDITED)
@pytest.mark.parametrize("app", TEXT_LOGS)
def test_a_text_log_of_a_phone_is_read_as_editors_save_it(app, edit, tmp_path, poses):
    text, start = TEXT_LOGS[app]
    (tmp_path / "log.txt").write_bytes(EDITED[edit](text()))
    survey = read_survey(tmp_path / "log.txt", poses(start))
    np.testing.assert_allclose(survey.field, 1e-6 * FIELD, atol=1e-9)


def sensor_logger(stamps):
    rows = (f"{stamp},{t},{z},{y},{x}\n" for stamp, t, (x, y, z) in zip(stamps, TIMES, FIELD, strict=True))
    return "time,seconds_elapsed,z,y,x\n" + "".join(rows)


@pytest.mark.parametrize("per_s", [1, 1_000, 1_000_000, None], ids=["s", "ms", "us", "dates"])
def test_times_of_sensor_logger_may_be_saved_in_other_units_and_as_dates(per_s, tmp_path, poses):
    dates = [f"2023-11-14T22:13:{20 + t:06.3f}Z" for t in TIMES]
    stamps = [f"{t * per_s:.3f}" for t in 1_700_000_000 + TIMES] if per_s else dates
    (tmp_path / "Magnetometer.csv").write_text(sensor_logger(stamps))
    survey = read_survey(tmp_path / "Magnetometer.csv", poses(1_700_000_000))
    np.testing.assert_allclose(survey.times, 1_700_000_000 + TIMES, rtol=0, atol=1e-6)


@pytest.mark.parametrize("step", [1, 10**5], ids=["to 1 s", "to 28 h"])
def test_times_of_sensor_logger_that_were_rounded_are_refused(step, tmp_path, poses):
    stamps = [round(t / step) * step * 10**9 for t in 1_700_000_000 + TIMES]
    (tmp_path / "Magnetometer.csv").write_text(sensor_logger(stamps))
    with pytest.raises(
        DataFormatError, match=r"column 'time': expected times as seconds_elapsed says.* a spreadsheet\?"
    ):
        read_survey(tmp_path / "Magnetometer.csv", poses(1_700_000_000))


def test_a_message_shows_times_that_differ(tmp_path, poses):
    rows = (f"{ns},0,{z},{y},{x}\n" for ns, (x, y, z) in zip(STAMPS, FIELD, strict=True))
    (tmp_path / "Magnetometer.csv").write_text("time,seconds_elapsed,z,y,x\n" + "".join(rows))
    with pytest.raises(DataFormatError, match=r"the field covers 1700 to 1700\.0000019 s"):
        read_survey(tmp_path / "Magnetometer.csv", poses(1_700_000_000))


def rostopic(topic, fields, values):
    """What `rostopic echo -p` writes: each message was received 2 ms after its stamp."""
    stamps = [1_700_000_000 * 10**9 + round(1e9 * t) for t in TIMES]
    names = ",".join(["%time,field.header.seq,field.header.stamp,field.header.frame_id", *fields])
    rows = [
        f"{t + 2_000_000},{k},{t},{topic}," + ",".join(map(repr, v))
        for k, (t, v) in enumerate(zip(stamps, values, strict=True))
    ]
    return "\n".join([names, *rows, ""])


POSE_FIELDS = [*(f"position.{a}" for a in "xyz"), *(f"orientation.{a}" for a in "xyzw")]
POSE_TOPICS = {
    "PoseStamped": ([f"field.pose.{name}" for name in POSE_FIELDS], []),
    "Odometry": (
        [f"field.pose.pose.{name}" for name in POSE_FIELDS],
        ["field.pose.covariance0", "field.twist.twist.linear.x", "field.twist.twist.angular.w"],
    ),
    "TransformStamped": (
        [
            f"field.transform.{n.replace('position', 'translation').replace('orientation', 'rotation')}"
            for n in POSE_FIELDS
        ],
        [],
    ),
}


@pytest.mark.parametrize("kind", POSE_TOPICS)
def test_topics_of_ros_printed_as_text_are_read_by_their_stamps(kind, tmp_path, capsys):
    fields, others = POSE_TOPICS[kind]
    turned = [0.0, 0.0, 1.0, 0.0]  # half a turn about z
    poses = [[k / 7, k % 3 / 2, 0.5, *turned, *(9.0 for _ in others)] for k in range(N)]
    (tmp_path / "poses.csv").write_text(rostopic("map", fields + others, poses))
    names = [f"field.magnetic_field.{a}" for a in "xyz"] + ["field.magnetic_field_covariance0"]
    (tmp_path / "mag.csv").write_text(rostopic("imu", names, np.column_stack([1e-6 * FIELD, 0 * TIMES]).tolist()))
    layout = SurveyFormat(trajectory=tmp_path / "poses.csv")
    survey = read_survey(tmp_path / "mag.csv", layout)
    np.testing.assert_allclose(survey.times, 1_700_000_000 + TIMES, rtol=0, atol=1e-6)
    np.testing.assert_allclose(survey.field, 1e-6 * FIELD * [-1, -1, 1], atol=1e-15)
    np.testing.assert_allclose(survey.positions, np.array(poses)[:, :3], atol=1e-6)
    axes = read_survey(tmp_path / "mag.csv", layout.model_copy(update={"columns": "bz=-bz"}))
    np.testing.assert_allclose(axes.field, 1e-6 * FIELD * [-1, -1, -1], atol=1e-15)
    assert main(["info", str(tmp_path / "poses.csv")]) == 0
    assert "trajectory" in capsys.readouterr().out
    with pytest.raises(DataFormatError, match=r"poses\.csv: holds poses, .* pass a trajectory beside it"):
        read_survey(tmp_path / "poses.csv")


@pytest.mark.parametrize(
    "row", ["walk,2023-11-14T22:13:20.25Z,1.5,2,3,0.1", "walk;2023-11-14 22:13:20,25;1,5;2;3;0,1"]
)
def test_fixed_points_may_have_dates(row, tmp_path):
    header = "log,t,x,y,z,sd".replace(",", row[4])
    (tmp_path / "points.csv").write_text(f"{header}\n{row}\n")
    (point,) = read_anchors(tmp_path / "points.csv")
    assert (point.t, point.position[0]) == (1_700_000_000.25, 1.5)


@pytest.mark.parametrize("date", ["01.05.2024 10:00:00", "5/1/2024 10:00:00 AM", "10:00:00.25"])
def test_dates_that_are_not_read_are_no_damage(date, tmp_path):
    """Leaving out such rows would leave none."""
    (tmp_path / "walk.csv").write_text(f"{NAMES}\n" + f"{date},1,2,3,2e-5,0,4e-5\n" * N)
    with pytest.raises(DataFormatError, match="dates such as") as refusal:
        read_survey(tmp_path / "walk.csv")
    assert "--recover" not in str(refusal.value)


HEADERS = {
    "capitals": "T,X,Y,Z,QX,QY,QZ,QW",
    "units": "time (s);pos_x (m);pos_y (m);pos_z (m);qx;qy;qz;qw",
    "words": "Time\tPosition X\tPosition Y\tPosition Z\tRotation X\tRotation Y\tRotation Z\tRotation W",
    "row numbers": ",t,x,y,z,qx,qy,qz,qw",
    "sep=": "sep=|\nt|x|y|z|qx|qy|qz|qw",
}


@pytest.mark.parametrize("case", HEADERS)
def test_poses_under_a_header_are_converted_and_told(case, tmp_path):
    header = HEADERS[case]
    mark = next(mark for mark in "|;\t," if mark in header)
    numbers = [[k] * header.startswith(",") + [k, k + 1, 2, 3, 0, 0, 1, 0] for k in range(5)]
    rows = [mark.join(map(str, row)) for row in numbers]
    (tmp_path / "poses.txt").write_text("\n".join([header, *rows, ""]))
    assert main(["convert", str(tmp_path / "poses.txt"), str(tmp_path / "out.tum")]) == 0
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "out.tum")[3], [3, 4, 2, 3, 0, 0, 1, 0])
    assert main(["info", str(tmp_path / "poses.txt")]) == 0


@pytest.mark.parametrize("names", ["qx,qy,qz,qw,hx,hy,hz", "qx,qy,qz,qw,mag_x,mag_y,mag_z"])
def test_a_survey_with_orientations_and_names_of_its_own_is_no_trajectory(names, tmp_path):
    rows = "".join(f"{t},{t},{t * t},0,0,0,0,1,2e-5,{t * 1e-6},4e-5\n" for t in TIMES.tolist())
    (tmp_path / "walk.csv").write_text(f"t,x,y,z,{names}\n{rows}")
    with pytest.raises(DataFormatError, match=r"missing bx, by, bz.*--columns"):
        read_survey(tmp_path / "walk.csv")


@pytest.mark.parametrize("text", ["1,2,3\n", "x [mm],y [mm],z [mm]\n1,2,3\n", "lat,lon,alt\n48,11,1\n"])
def test_refused_points_say_how_to_name_them(text, tmp_path):
    (tmp_path / "points.csv").write_text(text)
    with pytest.raises(DataFormatError, match="need a header row of these names"):
        read_points(tmp_path / "points.csv", SurveyFormat())


@pytest.mark.parametrize(
    ("theirs", "options", "words"),
    [
        (
            "bx [nT]",
            {"field_unit": "uT"},
            "column 'bx [nt]' is read in uT: is that what its name means? (--field-unit nT)",
        ),
        ("x_mm", {"field_unit": "uT"}, "column 'x_mm' is read in m: is that what its name means? (--length-unit mm)"),
        (
            "Feld [nT]",
            {"field_unit": "uT"},
            "column 'feld [nt]' is read in uT: is that what its name means? (--field",
        ),
        ("feld_m", {"field_unit": "uT"}, ""),
        ("bx (µT)", {"field_unit": "uT"}, ""),
        ("x [mm]", {"field_unit": "uT", "length_unit": "mm"}, ""),
    ],
)
def test_a_name_that_states_another_unit_than_the_option_is_told(theirs, options, words, tmp_path, caplog):
    ours = "x" if theirs.startswith("x") else "bx"
    rows = (f"{t},{t},{t * t},{t % 0.3},{x},{y},{z}\n" for t, (x, y, z) in zip(TIMES, FIELD, strict=True))
    names = NAMES.replace(f",{ours},", f",{theirs},")
    (tmp_path / "walk.csv").write_text(f"{names}\n{''.join(rows)}")
    for column in (theirs, NAMES.split(",").index(ours) + 1):
        caplog.clear()
        read_survey(tmp_path / "walk.csv", SurveyFormat(columns=f"{ours}={column}", **options))
        assert words in caplog.text
        assert ("its name means" in caplog.text) == bool(words)


def test_samples_for_a_trajectory_are_told_which_column_is_their_clock(tmp_path, poses):
    path = tmp_path / "toolbox.csv"
    np.savetxt(path, np.column_stack([TIMES, FIELD]), delimiter=",", header="time,Bx,By,Bz", comments="")
    with pytest.raises(DataFormatError, match=r"need times on its clock: --columns t=time$"):
        read_survey(path, poses(0))
    layout = SurveyFormat(trajectory=poses(0).trajectory, columns="t=time", field_unit="uT")
    survey = read_survey(path, layout)
    np.testing.assert_allclose(survey.times, TIMES)
