# SPDX-License-Identifier: BSD-3-Clause
"""Tables of other programs: Parquet from pyarrow and pandas, foreign column names, EuRoC files."""

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import load_trajectory
from magmatch.data.read import read_survey
from magmatch.errors import ConfigurationError

FOREIGN = "t=stamp,x=pos_x,y=pos_y,z=pos_z,bx=mag_x,by=mag_y,bz=mag_z"


def columns_of(survey):
    columns = {"t": survey.times}
    columns |= dict(zip(("x", "y", "z"), survey.positions.T, strict=True))
    columns |= dict(zip(("bx", "by", "bz"), survey.field.T, strict=True))
    return columns


def same(first, second):
    np.testing.assert_array_equal(first.times, second.times)
    np.testing.assert_array_equal(first.positions, second.positions)
    np.testing.assert_array_equal(first.field, second.field)


def test_float32_and_integers_are_numbers_too(room, tmp_path):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    frame = pd.DataFrame(columns_of(room)).astype({"bx": np.float32}).assign(z=np.arange(len(room)))
    frame.to_parquet(tmp_path / "room.parquet", compression="zstd")
    survey = read_survey(tmp_path / "room.parquet")
    np.testing.assert_array_equal(survey.field[:, 0], room.field[:, 0].astype(np.float32).astype(np.float64))


def test_foreign_column_names_in_csv_and_parquet(room, tmp_path):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    layout = SurveyFormat(columns=FOREIGN)
    names = {ours: theirs.upper() for ours, theirs in layout.stated_columns().items()}
    frame = pd.DataFrame(columns_of(room)).rename(columns=names).assign(x="not a position")
    frame.to_csv(tmp_path / "room.csv", index=False)
    frame.to_parquet(tmp_path / "room.parquet")
    same(read_survey(tmp_path / "room.csv", layout), room)
    same(read_survey(tmp_path / "room.parquet", layout), room)


@pytest.mark.parametrize("text", ["", "x", "x=", "x=a,x", "q=a", "x=a,x=b", "=a"])
def test_columns_that_are_no_pairs_are_refused(text, tmp_path, room):
    room.save(tmp_path / "room.csv")
    with pytest.raises(ConfigurationError, match="--columns: expected pairs"):
        read_survey(tmp_path / "room.csv", SurveyFormat(columns=text))


EUROC_POSES = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_x\n"
)


def test_euroc_poses_and_field(tmp_path):
    stamps = 1_403_636_580_838_555_648 + 5_000_000 * np.arange(30, dtype=np.int64)
    rows = [f"{t},{0.01 * i},{0.02 * i},1,0.8,0.6,0,0,9" for i, t in enumerate(stamps.tolist())]
    (tmp_path / "poses.csv").write_text(EUROC_POSES + "\n".join(rows) + "\n")
    rows = [f"{t},20,3,{-45 - 0.1 * i}" for i, t in enumerate(stamps[::2].tolist())]
    (tmp_path / "mag.csv").write_text("#timestamp [ns],b_x [uT],b_y [uT],b_z [uT]\n" + "\n".join(rows) + "\n")
    poses = load_trajectory(tmp_path / "poses.csv", SurveyFormat())
    np.testing.assert_allclose(poses.orientations.as_quat()[0], [0.6, 0, 0, 0.8])
    assert poses.times[3] == int(stamps[3]) / 10**9
    survey = read_survey(tmp_path / "mag.csv", SurveyFormat(trajectory=tmp_path / "poses.csv", field_unit="uT"))
    np.testing.assert_allclose(survey.positions[3], [0.06, 0.12, 1])
    np.testing.assert_allclose(survey.field[0], poses.orientations[0].apply([20e-6, 3e-6, -45e-6]), rtol=1e-12)
