# SPDX-License-Identifier: BSD-3-Clause
"""Gzip is read as what is in it, everywhere a table or a log is read; damage is refused."""

import gzip

import numpy as np
import pytest

from magmatch.data.read import read_survey
from magmatch.data.tables.text import plain_file
from magmatch.data.trajectory import Trajectory
from magmatch.data.write import SURVEY_WRITERS
from magmatch.errors import DataFormatError


def packed(path):
    """The file itself, packed, under a name that does not say so."""
    path.write_bytes(gzip.compress(path.read_bytes()))
    return path


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mcap"])
def test_a_packed_survey_is_the_survey(suffix, walk, tmp_path):
    pytest.importorskip({".parquet": "pyarrow", ".mcap": "mcap"}.get(suffix, "numpy"))
    path = tmp_path / f"walk{suffix}"
    SURVEY_WRITERS[suffix](walk, path)
    plain = read_survey(path)
    read = read_survey(packed(path))
    np.testing.assert_array_equal(read.field, plain.field)
    np.testing.assert_array_equal(read.times, plain.times)
    assert read.name == path.name


def test_a_packed_trajectory_is_the_trajectory(tmp_path):
    (tmp_path / "poses.tum").write_text("".join(f"{i} {i} 0 0 0 0 0 1\n" for i in range(20)))
    plain = Trajectory.load(tmp_path / "poses.tum")
    np.testing.assert_array_equal(Trajectory.load(packed(tmp_path / "poses.tum")).positions, plain.positions)


@pytest.mark.parametrize("where", [-1, -6, 12, 30])
def test_damage_is_said(where, walk, tmp_path):
    walk.save(tmp_path / "walk.csv")
    raw = packed(tmp_path / "walk.csv").read_bytes()
    for damaged in (raw[:where], bytes([*raw[:where], raw[where] ^ 255, *raw[where:][1:]])):
        (tmp_path / "walk.csv").write_bytes(damaged)
        with pytest.raises(DataFormatError, match=r"damaged gzip file|is not UTF-8|expected|found") as caught:
            read_survey(tmp_path / "walk.csv")
        assert str(caught.value).startswith(str(tmp_path / "walk.csv"))


def test_the_passing_copy_is_gone_and_never_named(tmp_path):
    pytest.importorskip("mcap")
    (tmp_path / "drive.mcap.gz").write_bytes(gzip.compress(b"\x89MCAP0\r\n" + bytes(40)))
    with plain_file(tmp_path / "drive.mcap.gz") as copy:
        assert copy.read_bytes().startswith(b"\x89MCAP")
    assert not copy.exists()
    with pytest.raises(DataFormatError) as caught:
        read_survey(tmp_path / "drive.mcap.gz")
    assert str(caught.value).startswith(str(tmp_path / "drive.mcap.gz"))
