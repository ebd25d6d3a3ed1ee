# SPDX-License-Identifier: BSD-3-Clause
"""What is saved comes back to the bit, or is refused in one line that names the file, however it was damaged."""

import json
from collections import namedtuple
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from crafted import apart, sealed, together
from magmatch import store
from magmatch.data.formats.sniff import sniff
from magmatch.errors import DataFormatError
from magmatch.store import dumps, expect, load, loads, open_stored, save

SCHEMA = "test/1"
Pair = namedtuple("Pair", "a b")


@dataclass(frozen=True)
class Noun:
    x: np.ndarray
    words: str
    more: tuple = ()


ROWS = np.zeros(3, [("n", "i8"), ("T", "f8", (3, 4)), ("b", "?")])
ROWS["T"] = np.arange(36.0).reshape(3, 3, 4) / 7
SHARED = np.arange(5.0)


def tree():
    T = RigidTransform.from_components([0.1, 2e5, -3], Rotation.from_rotvec([0.3, -0.2, 1.1]))
    return {
        "numbers": [1, -0.0, 0.1, 2**70, np.float64(1 / 3), np.int32(4), np.nan, -np.inf, None, True],
        "words": {"ä / „x“": "\n\0 ü", "": [], "{": {}},
        "arrays": [np.arange(12.0).reshape(4, 3).T, np.int32([[1]]), np.zeros((0, 3)), np.float32(2.5) * np.ones(())],
        "flags": np.array([True, False, True]),
        "rows": ROWS,
        "shared": (SHARED, SHARED),
        "T": T,
        "R": Rotation.random(3, rng=np.random.default_rng(0)),
        "nouns": (Noun(np.ones(2), "a", (Pair(1, SHARED),)),),
    }


def is_same(a, b):
    if isinstance(a, np.ndarray):
        same = (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
    elif isinstance(a, RigidTransform):
        same = np.array_equal(a.as_matrix(), b.as_matrix())
    elif isinstance(a, Rotation):
        same = np.array_equal(a.as_quat(), b.as_quat())
    elif isinstance(a, dict):
        same = [*a] == [*b] and all(is_same(a[key], b[key]) for key in a)
    elif isinstance(a, list | tuple):
        same = type(a) is type(b) and len(a) == len(b) and all(map(is_same, a, b))
    elif isinstance(a, Noun):
        same = is_same(vars(a), vars(b))
    else:
        same = repr(a if not isinstance(a, np.generic) else a.item()) == repr(b)
    return same


def test_a_tree_comes_back_to_the_bit(tmp_path):
    save(tmp_path / "a", SCHEMA, tree())
    found = load(tmp_path / "a", SCHEMA, (Noun, Pair))
    assert is_same(tree(), found)
    assert found["shared"][0] is found["shared"][1] is found["nouns"][0].more[0].b
    found["shared"][0][0] = 7.0  # one's own
    mapped = open_stored(tmp_path / "a", SCHEMA)
    mapped.check()
    seen = mapped.content((Noun, Pair))
    assert is_same(tree(), seen)
    assert not seen["flags"].flags.writeable


def test_the_same_tree_gives_the_same_bytes_and_another_one_another_digest(tmp_path):
    save(tmp_path / "a", SCHEMA, tree())
    assert (tmp_path / "a").read_bytes() == dumps(SCHEMA, load(tmp_path / "a", SCHEMA, (Noun, Pair)))
    digests = set()
    for changed in (tree(), tree() | {"T": 1}, tree() | {"rows": ROWS[:2]}, tree() | {"flags": np.array([True] * 3)}):
        save(tmp_path / "b", SCHEMA, changed)
        digests.add(open_stored(tmp_path / "b", SCHEMA).sha256)
    assert len(digests) == 4
    assert open_stored(tmp_path / "a", SCHEMA).sha256 in digests


def test_any_safetensors_reader_finds_the_arrays():
    raw = dumps(SCHEMA, {"x": np.arange(3.0), "n": np.int32([[7, 8]]), "y": {"z": np.ones((2, 2))}})
    n = int.from_bytes(raw[:8], "little")
    header = json.loads(raw[8 : 8 + n])
    assert all(isinstance(value, str) for value in header.pop("__metadata__").values())
    assert [*header] == ["x", "y.z", "n"]
    first, end = header["n"]["data_offsets"]
    assert header["n"] == {"dtype": "I32", "shape": [1, 2], "data_offsets": [56, 64]}
    assert np.frombuffer(raw[8 + n :][first:end], "<i4").tolist() == [7, 8]
    assert len(raw) == 8 + n + 64
    assert n % 8 == 0


def refusal(raw, path, schema=SCHEMA, kinds=(Noun, Pair)):
    """One line that names the file, whichever way it is read."""
    path.write_bytes(raw)
    said = []
    for read in (lambda: load(path, schema, kinds), lambda: checked(path, schema, kinds)):
        with pytest.raises(DataFormatError) as caught:
            read()
        said.append(str(caught.value))
        assert said[-1].startswith(f"{path}: ")
        assert "\n" not in said[-1]
        assert len(said[-1]) < 700
    assert said[0] == said[1]
    return said[0]


def checked(path, schema=SCHEMA, kinds=(Noun, Pair)):
    mapped = open_stored(path, schema)
    mapped.check()
    return mapped.content(kinds)


SMALL = dumps(SCHEMA, {"x": np.arange(4.0), "T": RigidTransform.identity(), "n": np.int32([1]), "w": "a"})


def test_every_flipped_byte_is_noticed(tmp_path):
    for at in range(len(SMALL)):
        for bit in (at % 8, 5):
            damaged = bytearray(SMALL)
            damaged[at] ^= 1 << bit
            with pytest.raises(DataFormatError, match=r"^state: "):
                loads(damaged, SCHEMA)
    assert "its arrays are not what was written" in refusal(SMALL[:-1] + b"\1", tmp_path / "a")


def test_a_map_with_one_damaged_byte_is_still_told_as_a_map(tmp_path):
    whole, n_told = dumps("magmatch.map/3", {"x": np.zeros(3)}), 0
    for at in range(len(whole)):
        (tmp_path / "a").write_bytes(whole[:at] + bytes([whole[at] ^ 1 << at % 8]) + whole[at + 1 :])
        with suppress(DataFormatError):  # where the schema says that it is something else
            n_told += sniff(tmp_path / "a") == "map"
    assert n_told >= len(whole) - len("magmatch.map/")


def test_every_cut_and_every_longer_file_is_refused(tmp_path):
    for n in range(len(SMALL)):
        with pytest.raises(DataFormatError):
            loads(SMALL[:n], SCHEMA)
    assert "is cut off or damaged" in refusal(SMALL[:300], tmp_path / "a")
    assert "is cut off or too long: expected 164 bytes of arrays, found 163" in refusal(SMALL[:-1], tmp_path / "a")
    assert "found 165" in refusal(SMALL + b"\0", tmp_path / "a")
    assert "begins with nothing" in refusal(b"", tmp_path / "a")


def crafted(change, content=None):
    """The small file with another header or content."""
    about, header, was, data = apart(SMALL)
    change(header, about)
    return together(about, header, was if content is None else content, data)


def entry(**changes):
    return lambda header, _about: header["x"].update(changes)


def nested(n):
    return "[" * n + "]" * n


HOSTILE = {
    "a negative header": (b"\xff" * 8 + SMALL[8:], "is cut off or damaged"),
    "not JSON": (sealed(b'",,}'), "Expecting property name"),
    "no metadata of ours": (sealed(b'"}}'), "entry 'data' is missing"),
    "metadata of numbers": (crafted(lambda _h, a: a.update(version=1)), "entry 'version' of the header"),
    "the same key twice": (sealed(b'","data":"","data":""}}'), "appears twice"),
    "nested too deep": (sealed(b'","x":' + nested(100_000).encode() + b"}}"), "recursion"),
    "content nested too deep": (crafted(lambda _h, _a: 0, content=nested(100_000)), "recursion"),
    "content a list": (crafted(lambda _h, _a: 0, content=[]), "expected an object, found a list"),
    "an array not there": (crafted(lambda _h, _a: 0, content={"x": {"$array": "y"}}), "entry 'y' is missing"),
    "a class not asked for": (crafted(lambda _h, _a: 0, content={"x": {"$Popen": {}}}), "holds a Popen"),
    "a class that lacks a field": (crafted(lambda _h, _a: 0, content={"x": {"$Noun": {}}}), "missing 2 required"),
    "a transform that is none": (crafted(lambda _h, _a: 0, content={"T": {"$transform": [[1]]}}), "4x4"),
    "a rotation that is none": (crafted(lambda _h, _a: 0, content={"T": {"$rotation": [[1, 2, 3, 4]]}}), "unit quat"),
    "rows of objects": (crafted(lambda _h, _a: 0, content={"x": {"$rows": ["x", [["a", "O"]], [4]]}}), "of numbers"),
    "rows of another width": (crafted(lambda _h, _a: 0, content={"x": {"$rows": ["x", [["a", "S3"]], [4]]}}), "size"),
    "an entry without a shape": (crafted(lambda h, _a: h["x"].pop("shape")), "entry 'shape' is missing"),
    "an entry with more": (crafted(entry(codec="pickle")), "expected dtype, shape and offsets"),
    "objects": (crafted(entry(dtype="O")), "expected dtype, shape and offsets"),
    "a negative shape": (crafted(entry(shape=[-4])), "expected dtype, shape and offsets"),
    "a huge shape": (crafted(entry(shape=[2**30, 2**30])), "bytes from"),
    "a shape of many axes": (crafted(entry(shape=[4, *[1] * 100])), "entry 'x'"),
    "an empty shape without end": (crafted(entry(shape=[0, 2**31, 2**31, 2**31], data_offsets=[0, 0])), "entry"),
    "offsets that overlap": (crafted(entry(data_offsets=[8, 40])), "bytes from"),
    "another file": (b"x,y,z,bx,by,bz\n", "is not a file that magmatch saved: it begins with b'x,y,z,bx"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_file_is_refused_though_its_digests_fit(case, tmp_path):
    raw, words = HOSTILE[case]
    assert words in refusal(raw, tmp_path / "a")


def test_another_schema_another_kind_of_path_and_too_much_are_refused(tmp_path, monkeypatch):
    assert "expected schema 'test/2', found 'test/1'; it is of another" in refusal(SMALL, tmp_path / "a", "test/2")
    assert refusal(SMALL, tmp_path / "a", "other/1").endswith("expected schema 'other/1', found 'test/1'")
    for path, words in [(tmp_path / "none", "no such file"), (tmp_path, "is a folder")]:
        for read in (load, open_stored):
            with pytest.raises(DataFormatError, match=words):
                read(path, SCHEMA)
    monkeypatch.setattr(store, "MAX_BYTES", 300)
    assert "is larger than any saved file (300 bytes)" in refusal(SMALL, tmp_path / "a")
    with pytest.raises(ValueError, match="expected at most 300 bytes"):
        save(tmp_path / "b", SCHEMA, {"x": np.zeros(100)})
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize("value", [{1: 2}, {"$a": 1}, {1, 2}, b"x", np.array([None]), np.array(["a"]), 1j])
def test_what_is_no_tree_of_numbers_is_not_written(value, tmp_path):
    with pytest.raises(TypeError, match="'a"):
        save(tmp_path / "a", SCHEMA, {"a": [value]})
    assert not list(tmp_path.iterdir())


def test_what_is_expected_of_a_tree_is_named():
    content = {"a": 1, "b": [1.0, 2.0], "c": None}
    expect(content, a=int, b=[float], c=(str, type(None)))
    with pytest.raises(TypeError, match="entry 'a': expected str, found 1"):
        expect(content, a=str)
    with pytest.raises(TypeError, match="entry 'b': expected int, found 1"):
        expect(content, b=[int])
    with pytest.raises(TypeError, match="entry 'c': expected int or str, found None"):
        expect(content, c=(int, str))
    with pytest.raises(KeyError, match="d"):
        expect(content, d=int)


def test_keys_that_join_to_the_same_name_keep_their_own_arrays():
    content = {"a": {"b": np.zeros(1)}, "a.b": np.ones(1), "__metadata__": np.full(1, 2.0)}
    assert is_same(content, loads(dumps(SCHEMA, content), SCHEMA))


def test_a_header_never_looks_like_gzip_zip_or_any_other_signature():
    """Eight bytes stand first: the header's length is a multiple of eight, and below what 'PK' would need."""
    assert {int.from_bytes(dumps(SCHEMA, {"w": n * "a"})[:8], "little") % 8 for n in range(16)} == {0}
    assert int.from_bytes(b"PK\x03\x04", "little") > store.MAX_HEADER
