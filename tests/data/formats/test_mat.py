# SPDX-License-Identifier: BSD-3-Clause
"""MATLAB files: arrays named as columns, in both versions; what is damaged or no survey is refused in one line."""

import gzip
import struct
import zlib

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.mat import read_mat
from magmatch.data.read import read_survey
from magmatch.errors import DataFormatError

N = 40
RNG = np.random.default_rng(3)
POSITIONS, FIELD = RNG.uniform(0, 3, (N, 3)), RNG.normal([20, 3, -45], 1, (N, 3))
TIMES = 0.1 * np.arange(N)
PLAIN = {
    "t": TIMES,
    **dict(zip("xyz", POSITIONS.T, strict=True)),
    **dict(zip(["bx", "by", "bz"], FIELD.T, strict=True)),
}
NESTED = {"data": {"Pos": POSITIONS, "mag": FIELD.T, "clock": {"stamp": TIMES}}, "note": "text", "k": np.eye(2) * 1j}
COLUMNS = ",".join(
    [
        *(f"{a}=data.Pos:{k + 1}" for k, a in enumerate("xyz")),
        *(f"b{a}=data.mag:{k + 1}" for k, a in enumerate("xyz")),
    ]
)


def v5(path, content, **options):
    scipy.io.savemat(path, content, **options)
    return path


def v73(path, content):
    h5py = pytest.importorskip("h5py")

    def put(group, fields):
        for name, value in fields.items():
            if isinstance(value, dict):
                put(group.create_group(name), value)
            elif np.isrealobj(value) and not isinstance(value, str):
                group[name] = np.atleast_2d(value).T

    with h5py.File(path, "w", userblock_size=512) as file:
        put(file, content)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: X".ljust(512))
    return path


def packed(path, content):
    return v5(path, content, do_compression=True)


def gzipped(path, content):
    v5(path, content)
    path.write_bytes(gzip.compress(path.read_bytes()))
    return path


@pytest.mark.parametrize("write", [v5, packed, v73, gzipped])
@pytest.mark.parametrize(("content", "columns"), [(PLAIN, None), (NESTED, f"t=data.clock.stamp,{COLUMNS}")])
def test_arrays_become_columns(write, content, columns, tmp_path):
    layout = SurveyFormat(columns=columns, field_unit="uT")
    survey = read_survey(write(tmp_path / "walk.mat", content), layout)
    np.testing.assert_array_equal(survey.positions, POSITIONS)
    np.testing.assert_array_equal(survey.field, FIELD * 1e-6)
    np.testing.assert_array_equal(survey.times, TIMES)


@settings(max_examples=60, deadline=None)
@given(
    values=hnp.arrays(
        st.sampled_from(["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"]),
        st.integers(2, 9),
        elements={"min_value": 0, "max_value": 100},
    ),
    is_packed=st.booleans(),
)
def test_numbers_of_every_type_are_read_as_they_were_written(values, is_packed, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "any.mat"
    scipy.io.savemat(path, {"A": values, "s": {"b": values}, "bx": values, "by": values, "bz": values},
                     do_compression=is_packed)  # fmt: skip
    table = read_mat(path, SurveyFormat(columns="x=a,y=S.B,z=0"))
    for name in ("x", "y"):
        np.testing.assert_array_equal(table.columns[name], values.astype(float))


BAD = {
    "other names": ({"mag": FIELD}, None, "expected arrays x, y, z, bx, by, bz; found mag ("),
    "only the times as named": ({"a": FIELD, "t": TIMES}, None, "expected arrays x, y, z, bx, by, bz; found a ("),
    "a name that is not there": (PLAIN, "bx=oops", "expected arrays oops; found "),
    "three columns for one": (NESTED, COLUMNS.replace(":1", "", 1), "expected one column of 40 x 3, data.pos:1"),
    "a fourth of three columns": (NESTED, COLUMNS.replace(":3", ":4", 1), "found 'data.pos:4'"),
    "arrays of two lengths": (PLAIN | {"x": np.zeros(7)}, None, "expected arrays of one length, found t 40, x 7"),
    "NaN": (PLAIN | {"x": np.where(TIMES[4] == TIMES, np.nan, 1.0)}, None, "line 5, column 'x': expected a finite"),
    "text": (PLAIN | {"x": "text"}, None, "missing x"),
}


@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("write", [v5, v73])
def test_a_file_that_holds_no_survey_says_what_it_holds(write, case, tmp_path):
    content, columns, words = BAD[case]
    path = write(tmp_path / "walk.mat", content)
    with pytest.raises(DataFormatError) as caught:
        read_survey(path, SurveyFormat(columns=columns, field_unit="uT"))
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_links_out_of_an_hdf5_file_are_not_followed(tmp_path):
    h5py = pytest.importorskip("h5py")
    v73(tmp_path / "other.mat", PLAIN)
    with h5py.File(tmp_path / "walk.mat", "w") as file:
        for name in PLAIN:
            file[name] = h5py.ExternalLink("other.mat", name)
    with pytest.raises(DataFormatError, match="expected arrays"):
        read_survey(tmp_path / "walk.mat", SurveyFormat(field_unit="uT"))


def test_an_array_without_a_shape_is_named_as_empty(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "walk.mat", "w") as file:
        for name, values in PLAIN.items():
            file[name] = h5py.Empty("f8") if name == "bx" else values
    with pytest.raises(DataFormatError, match="column 'bx': expected an array of numbers, found an empty one"):
        read_survey(tmp_path / "walk.mat", SurveyFormat(field_unit="uT"))


def test_without_h5py_the_extra_is_named(tmp_path, monkeypatch):
    path = v73(tmp_path / "walk.mat", PLAIN)
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(ImportError, match=r"pip install '\.\[matlab\]'"):
        read_survey(path)


FLAT = "x=data.Pos:1,y=data.Pos:2,bx=data.mag:1,by=data.mag:2,bz=data.mag:3"


@pytest.mark.parametrize("write", [v5, v73, packed])
def test_a_constant_stands_for_an_array(write, tmp_path):
    path = write(tmp_path / "walk.mat", NESTED)
    with pytest.raises(DataFormatError, match=r"missing z;.*--columns z=0"):
        read_survey(path, SurveyFormat(columns=FLAT, field_unit="uT"))
    survey = read_survey(path, SurveyFormat(columns=f"{FLAT},z=1.20", field_unit="uT"))
    np.testing.assert_array_equal(survey.positions[:, :2], POSITIONS[:, :2])
    np.testing.assert_array_equal(survey.positions[:, 2], 1.2)


def test_one_of_several_structures_is_named_by_its_number(tmp_path):
    walks = np.zeros(2, dtype=[("pos", object), ("mag", object)])
    walks[0], walks[1] = (POSITIONS + 1, FIELD), (POSITIONS, FIELD)
    path = v5(tmp_path / "walk.mat", {"walks": walks})
    with pytest.raises(DataFormatError, match=r"found walks\.1\.pos \(40 x 3\)"):
        read_survey(path)
    columns = COLUMNS.replace("data.Pos", "walks.2.pos").replace("data.mag", "walks.2.mag")
    np.testing.assert_array_equal(
        read_survey(path, SurveyFormat(columns=columns, field_unit="uT")).positions, POSITIONS
    )


def test_an_array_of_our_name_for_something_else_is_no_column(tmp_path):
    content = {"p": POSITIONS[:, :2].T, "x": FIELD[:, 0], "y": FIELD.T}
    columns = "x=p:1,y=p:2,z=0,bx=y:1,by=y:2,bz=y:3"
    survey = read_survey(v5(tmp_path / "walk.mat", content), SurveyFormat(columns=columns, field_unit="uT"))
    np.testing.assert_array_equal(survey.field, FIELD * 1e-6)


def test_a_file_without_arrays_is_said_to_hold_none(tmp_path):
    import h5py

    h5py.File(tmp_path / "empty.h5", "w").close()
    with pytest.raises(DataFormatError, match="the file holds none"):
        read_survey(tmp_path / "empty.h5")


def test_what_no_column_is_asked_of_is_not_read(tmp_path):
    """It may be large, or damaged."""
    path = v5(tmp_path / "walk.mat", PLAIN | {"images": RNG.normal(size=(300, 300))}, do_compression=True)
    raw = bytearray(path.read_bytes())
    raw[-200_000:-1000] = bytes(199_000)
    path.write_bytes(raw)
    np.testing.assert_array_equal(read_mat(path, SurveyFormat()).stack("bx", "by", "bz"), FIELD)


@pytest.mark.parametrize("packs", [False, True])
@pytest.mark.parametrize(
    ("part", "other"),
    [
        *(((9, 8 * N), (kind, 8 * N)) for kind in (0, 14, 15, 21, 255, 4000)),  # the type of its numbers
        ((6, 8, 6), (6, 8, 0x806)),  # complex, of which the file holds no imaginary part
        ((6, 8, 6), (6, 8, 5)),  # sparse, without indices
    ],
)
def test_numbers_that_are_not_there_are_damage(part, other, packs, tmp_path):
    """SciPy reads them from outside its memory: where it does, the process ends here."""
    content = v5(tmp_path / "a.mat", PLAIN).read_bytes()
    assert struct.pack(f"<{len(part)}I", *part) in content
    changed = content.replace(*(struct.pack(f"<{len(words)}I", *words) for words in (part, other)))
    if packs:
        changed = changed[:128] + b"".join(map(compressed, variables(changed[128:])))
    (tmp_path / "a.mat").write_bytes(changed)
    with pytest.raises(DataFormatError, match="is a damaged MATLAB file"):
        read_survey(tmp_path / "a.mat", SurveyFormat(field_unit="uT"))


def variables(data):
    """The variables of a file, one after the other."""
    while data:
        end = 8 + struct.unpack("<II", data[:8])[1]
        yield data[:end]
        data = data[end:]


def compressed(variable):
    raw = zlib.compress(variable)
    return struct.pack("<II", 15, len(raw)) + raw
