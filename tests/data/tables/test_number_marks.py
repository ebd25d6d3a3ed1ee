# SPDX-License-Identifier: BSD-3-Clause
"""Marks within numbers: what is certain is read, what may be two numbers is refused with both."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magmatch.data.formats.csv import read_points
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.read import read_survey, read_survey_and_channels
from magmatch.data.tables.number_marks import is_number, number_of_text, readings
from magmatch.errors import DataFormatError
from magmatch.slam.graph.anchors import read_anchors

N = 40
NAMES = ["t", "x", "y", "z", "bx", "by", "bz"]
NT = SurveyFormat(field_unit="nT", length_unit="mm", time_unit="ms")


@pytest.fixture
def numbers(rng):
    """Whole ms, mm and nT; the second component is sometimes below a thousand, and sometimes ends in zero."""
    field = np.column_stack([17_000 + rng.integers(0, 999, N), 2 * rng.integers(200, 999, N), -44_000 - np.arange(N)])
    field[::5, 1] = 10 * (field[::5, 1] // 10) + 1000
    field[::7, 1] = 987
    return np.column_stack([20 * np.arange(N), rng.integers(0, 4000, (N, 3)), field])


def table(path, numbers, cell, mark="\t", columns=range(4, 7), plain=str):
    rows = [mark.join(cell(v) if k in columns else plain(v) for k, v in enumerate(row)) for row in numbers.tolist()]
    path.write_text("\n".join([mark.join(NAMES), *rows, ""]))
    return path


def english(value):
    return f"{value:,}"


def german(value):
    return f"{value:,}".replace(",", "X").replace(".", ",").replace("X", ".")


GROUPS = {
    "Excel as text": ("\t", lambda v: f'"{v:,}"', str),
    "Excel, comma file": (",", lambda v: f'"{v:,}"' if abs(v) > 999 else str(v), str),
    "semicolons": (";", english, str),
    "with decimals": (";", lambda v: f"{v:,}.0", str),
    "comma file with decimals": (",", lambda v: f'"{v:,}.0"', lambda v: f"{v}.0"),
    "German with decimals": (";", lambda v: german(float(v)), str),
    "German beside decimals": ("\t", german, lambda v: f"{v},0"),
    "apostrophes": (",", lambda v: english(v).replace(",", "'"), str),
    "typographic apostrophes": (",", lambda v: english(v).replace(",", "\u2019"), str),
    "blanks": (",", lambda v: english(v).replace(",", " "), str),
    "narrow blanks and commas": (";", lambda v: english(v).replace(",", "\u202f") + ",0", str),
    "a minus sign": (",", lambda v: str(v).replace("-", "\u2212"), str),
    "a dash": ("\t", lambda v: f"{v},0".replace("-", "\u2013"), str),
}


@pytest.mark.parametrize("case", GROUPS)
def test_marks_that_can_mean_only_one_thing_are_read(case, numbers, tmp_path):
    mark, cell, plain = GROUPS[case]
    survey = read_survey(table(tmp_path / "s.csv", numbers, cell, mark, plain=plain), NT)
    np.testing.assert_allclose(survey.field, numbers[:, 4:] * 1e-9, rtol=1e-12)
    np.testing.assert_allclose(survey.positions, numbers[:, 1:4] / 1e3, rtol=1e-12)


def large(numbers):
    """Without numbers below a thousand."""
    return np.where(np.abs(numbers) < 1000, numbers + 1000, numbers)


@pytest.mark.parametrize("mark", ["\t", ",", ";"])
def test_numbers_that_may_be_two_are_refused_with_both_and_the_advice_works(mark, numbers, tmp_path):
    path = table(tmp_path / "s.csv", large(numbers), lambda v: f'"{v:,}"', mark)
    first = large(numbers)[0, 4]
    with pytest.raises(DataFormatError) as caught:
        read_survey(path, NT)
    words = str(caught.value)
    assert f"line 2, column 'bx': found '{first:,}', which is {first} or {first / 1000:.15g}" in words
    assert "--recover" not in words
    for decimal, scale in (("point", 1), ("comma", 1000)):
        assert f"--decimal {decimal}" in words
        survey = read_survey(path, NT.model_copy(update={"decimal": decimal}))
        np.testing.assert_allclose(survey.field, large(numbers)[:, 4:] * 1e-9 / scale, rtol=1e-12)


def test_points_where_decimals_are_unlikely_are_refused_with_both(numbers, tmp_path):
    path = table(tmp_path / "s.csv", numbers, german, ";")
    with pytest.raises(DataFormatError, match=r"--decimal point reads [\d.]+, --decimal comma \d+$"):
        read_survey(path, NT)
    survey = read_survey(path, NT.model_copy(update={"decimal": "comma"}))
    np.testing.assert_allclose(survey.field, numbers[:, 4:] * 1e-9, rtol=1e-12)


def test_decimals_of_three_digits_stay_decimals(numbers, tmp_path):
    thousandths = large(numbers) / 1000
    for cell in ("{:.3f}".format, repr):
        survey = read_survey(
            table(tmp_path / "s.csv", thousandths, cell, ";", plain=cell), SurveyFormat(field_unit="uT")
        )
        np.testing.assert_allclose(survey.field, thousandths[:, 4:] * 1e-6, rtol=1e-12)


def test_the_stated_mark_settles_doubts_only(numbers, tmp_path):
    path = table(tmp_path / "s.csv", numbers, lambda v: f"{v}.5", ";")
    said = read_survey(path, NT.model_copy(update={"decimal": "comma"}))
    np.testing.assert_array_equal(said.field, read_survey(path, NT).field)


def test_a_second_decimal_mark_is_refused_and_not_left_out(numbers, tmp_path):
    path = table(tmp_path / "s.csv", numbers, lambda v: f"{v},5" if v > 0 else f"{v}.5", ";")
    with pytest.raises(DataFormatError, match="where other numbers have decimal commas") as caught:
        read_survey(path, NT)
    assert "--recover" not in str(caught.value)


def test_other_columns_are_read_with_the_mark_of_the_survey(numbers, tmp_path):
    rows = [";".join([*(f"{v},5" for v in row), "1,250"]) for row in numbers.tolist()]
    (tmp_path / "s.csv").write_text("\n".join([";".join([*NAMES, "motor"]), *rows]))
    _, channels = read_survey_and_channels(tmp_path / "s.csv", NT)
    np.testing.assert_array_equal(channels["motor"], np.full(N, 1.25))


def test_points_to_query_and_fixed_points_have_the_same_rules(tmp_path):
    (tmp_path / "p.csv").write_text("x;y;z\n0,5;\u22121,250;1.234,5\n")
    np.testing.assert_array_equal(read_points(tmp_path / "p.csv", SurveyFormat()), [[0.5, -1.25, 1234.5]])
    (tmp_path / "p.csv").write_text("x;y;z\n1,500;2,250;3,125\n")
    with pytest.raises(DataFormatError, match=r"found '1,500', which is 1500 or 1.5: .*; write 1500 or 1.5$"):
        read_points(tmp_path / "p.csv", SurveyFormat())
    (tmp_path / "a.csv").write_text("sep=;\nlog;t;x;y;z;sd\nwalk;1.234,5;\u22120,5;2;3;0,05\n")
    assert read_anchors(tmp_path / "a.csv")[0].numbers == (1234.5, -0.5, 2.0, 3.0, 0.05)


def test_rows_of_phones_have_the_same_rules(tmp_path):
    rows = [f"{5_000_000_000 + 20_000_000 * i};2;18,5;\u22123,25;\u221244,339" for i in range(N)]
    (tmp_path / "log.csv").write_text("\n".join(["event.timestamp;event.sensor;x;y;z", *rows]))
    stream = read_phone_log(tmp_path / "log.csv").streams["field"]
    np.testing.assert_allclose(stream.values[0], [18.5e-6, -3.25e-6, -44.339e-6], rtol=1e-12)
    rows = [f"MAGN;{i},5;{5 + i},5;18,5;\u22123,25;44,339;3" for i in range(N)]
    (tmp_path / "log.txt").write_bytes("\n".join(rows).replace("\u2212", "-").encode())
    np.testing.assert_allclose(read_phone_log(tmp_path / "log.txt").streams["field"].values[0, 2], 44.339e-6)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_what_python_writes_is_read_to_the_bit_with_either_mark(value):
    assert number_of_text(repr(value)) == value
    if "." in repr(value):
        assert number_of_text(repr(value).replace(".", ","), "comma") == value


@given(st.integers(0, 10**15), st.integers(0, 10**6))
def test_groups_do_not_change_a_number(whole, fraction):
    text = f"{whole:,}.{fraction:06d}"
    assert number_of_text(text) == float(f"{whole}.{fraction:06d}")
    assert number_of_text(german_text(text), "comma") == number_of_text(text)
    assert set(readings(text)) == {"point"}


def german_text(text):
    return text.translate(str.maketrans(",.", ".,"))


@pytest.mark.parametrize(
    "text", ["1,23,4", "12,34,567", "1.2.3", "1,234.567.8", "1 23", "(44.3)", "12 uT", "", "-", "1'23"]
)
def test_what_is_no_number_is_none(text):
    assert not is_number(text)
