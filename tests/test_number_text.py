# SPDX-License-Identifier: BSD-3-Clause
"""Numbers in files read back to the last bit; numbers in messages show what tells them apart."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magmatch.arguments import require_increasing
from magmatch.data.tables.table import Wanted, read_table
from magmatch.errors import DataFormatError
from magmatch.number_text import exact, told

UNIX = 1_700_000_005.14


@given(st.lists(st.floats(allow_nan=False), min_size=1))
def test_a_number_of_a_file_reads_back_to_the_last_bit(numbers):
    assert [float(text) for text in exact(numbers)] == numbers


@given(st.integers(0, 2**31), st.integers(0, 99))
def test_times_that_differ_by_a_hundredth_are_not_told_alike(seconds, hundredths):
    t = seconds + hundredths / 100
    assert told(t) != told(t + 0.01)
    assert float(told(t)) == t


def test_a_step_is_told_however_large_the_number():
    assert told(5_334_583.9912, 4, 1e-3) == "5334583.991"
    assert told(0.123456, 4, 1e-3) == "0.1235"
    assert [told(x, 4, 1e-3) for x in (0.0, np.inf, np.nan)] == ["0", "inf", "nan"]


def test_a_time_that_runs_backward_is_told_in_full(tmp_path):
    with pytest.raises(ValueError, match=r"1700000005\.14 after 1700000005\.15 s"):
        require_increasing(np.array([UNIX, UNIX + 0.01, UNIX]))
    path = tmp_path / "t.csv"
    path.write_text(f"t,x\n{UNIX + 0.01!r},0\n{UNIX!r},1\n")
    with pytest.raises(DataFormatError, match=r"1700000005\.14 after 1700000005\.15;"):
        read_table(path, Wanted(("t", "x"))).require_increasing("t")
