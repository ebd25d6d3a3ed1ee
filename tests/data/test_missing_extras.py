# SPDX-License-Identifier: BSD-3-Clause
"""A package that is not installed is named by the extra that brings it, and only where it is needed."""

import sys

import pytest

from magmatch.data.read import read_survey
from magmatch.data.write import SURVEY_WRITERS
from magmatch.errors import MissingExtraError


def hide(monkeypatch, *names):
    for name in names:
        for loaded in [key for key in sys.modules if key == name or key.startswith(name + ".")]:
            monkeypatch.setitem(sys.modules, loaded, None)
        monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.parametrize(
    ("suffix", "package", "extra"),
    [
        (".mcap", "mcap", "ros"),
        (".mcap", "zstandard", "ros"),
        (".mcap", "rosbags", "ros"),
        (".parquet", "pyarrow", "parquet"),
    ],
)
def test_reading_and_writing_name_the_extra_and_tables_need_none(suffix, package, extra, walk, tmp_path, monkeypatch):
    pytest.importorskip(package)
    SURVEY_WRITERS[suffix](walk, tmp_path / f"walk{suffix}")
    walk.save(tmp_path / "walk.csv")
    hide(monkeypatch, package, "magmatch.data.logs.containers")
    assert len(read_survey(tmp_path / "walk.csv")) == len(walk)
    with pytest.raises(MissingExtraError, match=rf"pip install '\.\[{extra}\]'"):
        read_survey(tmp_path / f"walk{suffix}")
    if package in {"mcap", "pyarrow"}:
        with pytest.raises(MissingExtraError, match=rf"pip install '\.\[{extra}\]'"):
            SURVEY_WRITERS[suffix](walk, tmp_path / f"again{suffix}")
        assert not (tmp_path / f"again{suffix}").exists()
