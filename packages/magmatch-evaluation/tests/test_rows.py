# SPDX-License-Identifier: BSD-3-Clause
"""Rows survive being cut off anywhere."""

import csv
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magmatch.errors import DataFormatError
from magmatch_evaluation.rows import Row, RowFile, write_csv


def some_rows(n):
    return [
        Row("e", "m", seed, "d", "accepted", "ü |", True, True, 0.1 / (seed + 1), math.inf, math.nan, 5, 6, 0.5, 7)
        for seed in range(n)
    ]


def same(one, other):
    return [repr(row) for row in one] == [repr(row) for row in other]


def test_rows_come_back_as_they_were_written(tmp_path):
    kept = RowFile(tmp_path / "rows.jsonl", Row)
    assert kept.read() == []
    kept.append(some_rows(3)[:2])
    kept.append(some_rows(3)[2:])
    assert same(kept.read(), some_rows(3))


@given(st.integers(0, 100))
def test_file_cut_off_anywhere_gives_its_whole_rows_and_goes_on(tmp_path_factory, share):
    kept = RowFile(tmp_path_factory.mktemp("cut") / "rows.jsonl", Row)
    kept.append(some_rows(4))
    content = kept.path.read_bytes()
    cut = len(content) * share // 100
    kept.path.write_bytes(content[:cut])
    n_whole = content[:cut].count(b"\n")
    assert same(kept.read(), some_rows(n_whole))
    kept.mend()
    kept.append(some_rows(4)[n_whole:])
    assert same(kept.read(), some_rows(4))


def test_of_two_rows_with_one_key_the_first_counts(tmp_path):
    kept = RowFile(tmp_path / "rows.jsonl", Row)
    kept.append(some_rows(1))
    twice = some_rows(1)[0]
    kept.append([replace(twice, status="other")])
    assert same(kept.read(), some_rows(1))


@pytest.mark.parametrize("line", ["{}", "[1]", "no json", '{"experiment": 1}'])
def test_foreign_file_is_named_with_its_line(tmp_path, line):
    kept = RowFile(tmp_path / "rows.jsonl", Row)
    kept.append(some_rows(1))
    with kept.path.open("a") as stream:
        stream.write(line + "\n")
    with pytest.raises(DataFormatError, match=r"rows\.jsonl, line 2: is not a row of an evaluation"):
        kept.read()


def test_table_for_other_programs_does_not_depend_on_the_order_of_work(tmp_path):
    write_csv(tmp_path / "a.csv", some_rows(3), Row)
    write_csv(tmp_path / "b.csv", some_rows(3)[::-1], Row)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    found = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert [float(row["distance"]) for row in found] == [row.distance for row in some_rows(3)]
