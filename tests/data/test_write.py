# SPDX-License-Identifier: BSD-3-Clause
"""What is written, other programs read: pyarrow, pandas, the mcap library with rosbags' types, VTK."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.read import read_survey
from magmatch.data.survey import Survey
from magmatch.data.write import SURVEY_WRITERS
from magmatch.errors import SurveyError

NS = 1_700_000_000_000_000_000 + 37_123_457 * np.arange(60, dtype=np.int64) + 123


@pytest.fixture
def walk(rng):
    """Sixty samples at whole nanoseconds since 1970, quaternions as a file gives them."""
    n = len(NS)
    positions, field = rng.uniform(0, 3, (n, 3)), rng.normal([2e-5, 0, -4e-5], 1e-6, (n, 3))
    turns = Rotation.from_quat(np.round(Rotation.random(n, rng=rng).as_quat(), 6))
    times = np.array([stamp / 10**9 for stamp in NS.tolist()])
    return Survey(positions, field, times, turns, frame="hall", name="walk", pose_sd=0.02)


def write(survey, path):
    SURVEY_WRITERS[path.suffix](survey, path)
    return path


def test_csv_parquet_and_mcap_read_back_as_one_survey_bit_for_bit(walk, tmp_path, caplog):
    surveys = [read_survey(write(walk, tmp_path / f"walk.{kind}")) for kind in ("csv", "parquet", "mcap")]
    for survey in surveys:
        np.testing.assert_array_equal(survey.times, walk.times)
        np.testing.assert_array_equal(survey.positions, walk.positions)
        np.testing.assert_array_equal(survey.field, walk.field)
        np.testing.assert_array_equal(survey.orientations.as_quat(), surveys[0].orientations.as_quat())
        assert survey.frame == "hall"
    assert [survey.pose_sd for survey in surveys] == [0.02, 0.02, 0.0]
    assert "magmatch.data.logs" not in caplog.text


def test_mcap_is_read_by_the_mcap_library_and_typed_by_rosbags(walk, tmp_path):
    pytest.importorskip("rosbags")
    from mcap.reader import make_reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    path = write(walk, tmp_path / "walk.mcap")
    store = get_typestore(Stores.EMPTY)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema in reader.get_summary().schemas.values():
            types = get_types_from_msg(schema.data.decode(), schema.name)
            store.register({name: kind for name, kind in types.items() if name not in store.fielddefs})
        found = {"/magmatch/field": [], "/magmatch/pose": []}
        for schema, channel, message in reader.iter_messages():
            found[channel.topic].append((message.log_time, store.deserialize_cdr(message.data, schema.name)))
    stamps = [t for t, _ in found["/magmatch/field"]]
    assert [t / 10**9 for t in stamps] == walk.times.tolist()
    stamp = found["/magmatch/field"][5][1].header.stamp
    assert (stamp.sec, stamp.nanosec) == divmod(stamps[5], 10**9)
    field = [(m.magnetic_field.x, m.magnetic_field.y, m.magnetic_field.z) for _, m in found["/magmatch/field"]]
    np.testing.assert_array_equal(field, walk.field)
    poses = [m.pose for _, m in found["/magmatch/pose"]]
    np.testing.assert_array_equal([(p.position.x, p.position.y, p.position.z) for p in poses], walk.positions)
    turns = [(p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w) for p in poses]
    np.testing.assert_array_equal(turns, walk.orientations.as_quat())
    assert {m.header.frame_id for _, m in found["/magmatch/pose"]} == {"hall"}


@pytest.mark.parametrize("suffix", [".mcap", ".tum"])
def test_a_survey_without_times_cannot_become_a_log(suffix, walk, tmp_path):
    with pytest.raises(SurveyError, match="has no times"):
        write(Survey(walk.positions, walk.field), tmp_path / f"walk{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_positions_without_orientations_go_through_mcap(walk, tmp_path):
    bare = Survey(walk.positions, walk.field, walk.times)
    survey = read_survey(write(bare, tmp_path / "bare.mcap"))
    assert survey.orientations is None
    np.testing.assert_array_equal(survey.field, walk.field)


def test_times_that_ros_cannot_state_are_refused(walk, tmp_path):
    with pytest.raises(SurveyError, match="ROS knows"):
        write(Survey(walk.positions, walk.field, walk.times * 2), tmp_path / "walk.mcap")


def test_vtk_and_ply_points_are_read_by_vtk(walk, tmp_path):
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    reader = vtk.vtkPolyDataReader()
    reader.SetFileName(str(write(walk, tmp_path / "walk.vtk")))
    reader.ReadAllVectorsOn()
    reader.Update()
    points = reader.GetOutput()
    np.testing.assert_array_equal(vtk_to_numpy(points.GetPoints().GetData()), walk.positions)
    np.testing.assert_array_equal(vtk_to_numpy(points.GetPointData().GetArray("field")), walk.field)
    assert points.GetNumberOfVerts() == len(walk)
    reader = vtk.vtkPLYReader()
    reader.SetFileName(str(write(walk, tmp_path / "walk.ply")))
    reader.Update()
    np.testing.assert_allclose(vtk_to_numpy(reader.GetOutput().GetPoints().GetData()), walk.positions, rtol=1e-6)


def test_ply_holds_its_numbers_in_double_precision(walk, tmp_path):
    raw = write(walk, tmp_path / "walk.ply").read_bytes()
    head, _, body = raw.partition(b"end_header\n")
    assert b"property double bz" in head
    rows = np.frombuffer(body, "<f8").reshape(len(walk), 6)
    np.testing.assert_array_equal(rows, np.hstack([walk.positions, walk.field]))
