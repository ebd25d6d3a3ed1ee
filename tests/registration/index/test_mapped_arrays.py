import numpy as np
import pytest

from magmatch.errors import DataFormatError
from magmatch.registration.index.mapped_arrays import open_mapped, write_mapped

SCHEMA = "test/1"


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "arrays"
    arrays = {"x": np.arange(12.0).reshape(4, 3), "rows": np.arange(5, dtype=np.int32), "none": np.zeros((0, 3))}
    write_mapped(path, SCHEMA, {"length": 1.25}, arrays)
    return path, arrays


def test_arrays_and_attributes_come_back_as_they_were(written):
    path, arrays = written
    found = open_mapped(path, SCHEMA)
    found.check()
    assert found.attributes == {"length": 1.25}
    assert found.arrays.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array)
        assert found.arrays[name].dtype == array.dtype


def test_the_same_content_gives_the_same_bytes(written, tmp_path):
    path, arrays = written
    write_mapped(tmp_path / "again", SCHEMA, {"length": 1.25}, arrays)
    assert (tmp_path / "again").read_bytes() == path.read_bytes()


def test_every_flipped_byte_is_noticed(written):
    path, _ = written
    content = path.read_bytes()
    used = len(content) - 64 - 48  # the padding behind the last arrays says nothing
    for place in range(0, used, 7):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        with pytest.raises(DataFormatError):
            open_mapped(path, SCHEMA).check()


@pytest.mark.parametrize("length", [0, 10, 60, 300])
def test_a_cut_off_file_is_refused(written, length):
    path, _ = written
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(DataFormatError):
        open_mapped(path, SCHEMA).check()


def test_another_schema_or_no_file_is_refused(written, tmp_path):
    with pytest.raises(DataFormatError, match="schema"):
        open_mapped(written[0], "test/2")
    with pytest.raises(DataFormatError, match="cannot be read"):
        open_mapped(tmp_path / "nothing", SCHEMA)
