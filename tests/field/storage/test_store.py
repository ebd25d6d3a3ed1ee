# SPDX-License-Identifier: BSD-3-Clause
"""A saved map is the map, to the bit; whatever is not one is refused in one line."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import zipfile
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
import zarr
from scipy.spatial.transform import Rotation
from zarr.storage import ZipStore

from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.field.priors import PRIORS
from magmatch.field.storage.archive import MANIFEST, read_archive
from magmatch.field.storage.store import SCHEMA, MapRecord
from magmatch.geometry import random_transform


def make_survey(n=60, seed=0, **changes):
    rng = np.random.default_rng(seed)
    p = rng.uniform(0, [2.0, 1.5, 0.5], (n, 3))
    b = 4e-5 + 1e-5 * np.stack([np.sin(p[:, 0]), np.cos(p[:, 1]), np.sin(p[:, 2] + p[:, 0])], axis=1)
    fields = {
        "positions": p,
        "field": b + rng.normal(0, 1e-7, (n, 3)),
        "times": np.arange(float(n)) / 10,
        "orientations": Rotation.random(n, rng=rng),
        "frame": "odom",
        "name": "Flur – 1",
        "pose_sd": 0.01,
    }
    return Survey(**(fields | changes))


def make_map(prior="spline", **changes):
    config = FieldConfig(prior=prior, lengthscale=0.8, signal_sd=1e-5, noise_sd=1e-7, spacing=0.5)
    return build_map(make_survey(**changes), config)


@pytest.fixture(scope="module", params=sorted(PRIORS))
def field_map(request):
    return make_map(request.param)


@pytest.fixture(scope="module")
def spline_map():
    return make_map()


@pytest.fixture
def saved(spline_map, tmp_path):
    spline_map.save(tmp_path / "room.map")
    return tmp_path / "room.map"


def says(field_map, points):
    """All that a map answers, as one list of arrays."""
    values = field_map.evaluate(points, 2)
    return [values.field, values.gradient, values.second, field_map.covariance(points), field_map.knows(points)]


def points_around(n=200):
    return np.random.default_rng(1).uniform([-2, -2, -1], [4, 3, 2], (n, 3))


def refusal(path):
    """The message with which a file is refused: one line that names the file."""
    with pytest.raises(DataFormatError) as caught:
        FieldMap.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def test_loaded_map_says_the_same_to_the_bit(field_map, tmp_path):
    field_map.save(tmp_path / "m")
    loaded = FieldMap.load(tmp_path / "m")
    for before, after in zip(says(field_map, points_around()), says(loaded, points_around()), strict=True):
        assert np.array_equal(before, after)
    grid = field_map.grid_over(0.3)
    assert np.array_equal(loaded.on_grid(grid).values.second, field_map.on_grid(grid).values.second)
    draws = [m.draw(points_around(5), 3, 1, np.random.default_rng(2))[2].gradient for m in (field_map, loaded)]
    assert np.array_equal(*draws)


def test_map_carried_to_another_frame_comes_back_to_the_bit(field_map, tmp_path):
    moved = field_map.transformed(random_transform(np.random.default_rng(5), 1000.0))
    moved.save(tmp_path / "m")
    loaded = FieldMap.load(tmp_path / "m")
    points = moved.survey.positions
    for before, after in zip(says(moved, points), says(loaded, points), strict=True):
        assert np.array_equal(before, after)
    assert np.array_equal(loaded.T_map_model.as_matrix(), moved.T_map_model.as_matrix())


def test_samples_and_settings_come_back_to_the_bit(field_map, tmp_path):
    field_map.save(tmp_path / "m")
    loaded = FieldMap.load(tmp_path / "m")
    before, after = field_map.survey, loaded.survey
    for name in ("positions", "field", "times"):
        assert np.array_equal(getattr(after, name), getattr(before, name))
    assert np.array_equal(after.orientations.as_quat(), before.orientations.as_quat())
    assert (after.frame, after.name, after.pose_sd) == ("odom", "Flur – 1", 0.01)
    assert loaded.config == field_map.config
    assert loaded.hyperparameters == field_map.hyperparameters
    assert np.array_equal(loaded.posterior.weights, field_map.posterior.weights)


def test_survey_without_times_and_orientations_comes_back_without(tmp_path):
    make_map(times=None, orientations=None).save(tmp_path / "m")
    survey = FieldMap.load(tmp_path / "m").survey
    assert survey.times is None
    assert survey.orientations is None


def test_same_map_gives_the_same_bytes_at_any_time(field_map, tmp_path, monkeypatch):
    field_map.save(tmp_path / "a")
    monkeypatch.setattr("time.time", lambda: 2e9)
    FieldMap.load(tmp_path / "a").save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_any_zarr_reader_opens_the_file(saved, spline_map):
    store = ZipStore(saved, mode="r")
    group = zarr.open_group(store, mode="r")
    assert sorted(group.array_keys()) == [
        "field.0", "model_field.0", "model_positions.0", "orientations.0", "positions.0", "tile.0.0.0", "times.0",
    ]  # fmt: skip
    assert np.array_equal(group["positions.0"][...], spline_map.survey.positions)
    assert [type(c).__name__ for c in group["tile.0.0.0"].metadata.codecs] == ["BytesCodec", "Crc32cCodec"]
    assert group["manifest"].attrs["schema"] == "magmatch.map/2"
    store.close()


def test_manifest_states_every_entry(saved):
    with zipfile.ZipFile(saved) as archive:
        listing = json.loads(archive.read(MANIFEST))["attributes"]["entries"]
        assert listing.keys() == set(archive.namelist()) - {MANIFEST}
        assert archive.namelist() == sorted(archive.namelist())
        for name, claim in listing.items():
            assert hashlib.sha256(archive.read(name)).hexdigest() == claim["sha256"]


def test_samples_are_read_without_fitting(saved, monkeypatch):
    monkeypatch.setattr("magmatch.field.storage.store.fit_posterior", None)
    assert len(MapRecord.read(saved).survey) == 60


def test_long_arrays_are_split_into_chunks_and_joined_again(tmp_path, monkeypatch, spline_map):
    monkeypatch.setattr("magmatch.field.storage.archive.ROWS_PER_CHUNK", 7)
    spline_map.save(tmp_path / "m")
    with zipfile.ZipFile(tmp_path / "m") as archive:
        assert sum(name.startswith("positions.0/c/") for name in archive.namelist()) == 9
    assert np.array_equal(MapRecord.read(tmp_path / "m").survey.field, spline_map.survey.field)


def test_no_flipped_byte_and_no_cut_goes_unnoticed(saved, spline_map):
    whole = saved.read_bytes()
    points = points_around(20)
    expected = says(spline_map, points)
    rng = np.random.default_rng(0)
    n_refused = 0
    for k in range(500):
        damaged = bytearray(whole)
        if k % 5 == 0:
            del damaged[rng.integers(len(whole)) :]
        else:
            # Half of them where zip keeps its own books, which are few bytes.
            low = whole.index(b"PK\x01\x02") if k % 2 else 0
            damaged[rng.integers(low, len(whole))] ^= int(rng.integers(1, 256))
        saved.write_bytes(damaged)
        try:
            loaded = FieldMap.load(saved)
        except DataFormatError:
            n_refused += 1
        else:
            assert all(np.array_equal(a, b) for a, b in zip(says(loaded, points), expected, strict=True))
            assert loaded.survey.name == spline_map.survey.name
            loaded.save(saved)
            assert saved.read_bytes() == whole
    assert n_refused > 250


def test_flipped_byte_in_an_array_is_named(saved):
    with zipfile.ZipFile(saved) as archive:
        start = archive.getinfo("positions.0/c/0/0").header_offset + 30 + len("positions.0/c/0/0")
    damaged = bytearray(saved.read_bytes())
    damaged[start + 100] ^= 1
    saved.write_bytes(damaged)
    assert "entry 'positions.0/c/0/0' is damaged" in refusal(saved)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not a saved map"),
        (b"x,y,z,bx,by,bz\n", "is not a saved map"),
        (b"\x80\x04\x95", "is not a saved map"),
        (b"PK\x03\x04" + bytes(50), "cut off"),
    ],
)
def test_another_type_of_file_is_refused(tmp_path, content, message):
    (tmp_path / "m").write_bytes(content)
    assert message in refusal(tmp_path / "m")


def test_another_zip_archive_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "m", "w") as archive:
        archive.writestr("zarr.json", "{}")
    assert f"entry '{MANIFEST}' is missing" in refusal(tmp_path / "m")


def test_missing_file_and_folder_are_named(tmp_path, spline_map):
    assert "no such file" in refusal(tmp_path / "none")
    assert "is a folder" in refusal(tmp_path)
    with pytest.raises(DataFormatError, match="does not exist; create it first"):
        spline_map.save(tmp_path / "none" / "m")


def test_map_that_could_not_be_read_back_is_not_written(tmp_path, spline_map, monkeypatch):
    monkeypatch.setattr("magmatch.field.storage.archive.MAX_BYTES", 20_000)
    with pytest.raises(ValueError, match="expected less than 20000 bytes"):
        spline_map.save(tmp_path / "m")
    assert not list(tmp_path.iterdir())


def test_directory_of_countless_entries_is_refused(tmp_path, monkeypatch):
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for k in range(300):
            archive.writestr(f"a/c/{k}", b"")
    monkeypatch.setattr("magmatch.field.storage.archive_checks.MAX_ENTRIES", 10)
    (tmp_path / "m").write_bytes(buffer.getvalue())
    assert "zip directory" in refusal(tmp_path / "m")


def test_map_with_nan_is_not_written(tmp_path, spline_map):
    broken = replace(spline_map, survey=replace(spline_map.survey, positions=spline_map.survey.positions.copy()))
    broken.survey.positions[3] = np.nan
    with pytest.raises(ValueError, match="expected finite positions"):
        broken.save(tmp_path / "m")
    assert not list(tmp_path.iterdir())


WRITER = """
import sys
from magmatch.field.storage.archive import read_archive, write_archive
path, schema, *sources = sys.argv[1:]
contents = [read_archive(source, schema) for source in sources]
while True:
    for content in contents:
        write_archive(path, schema, *content)
        print(flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kills with a POSIX signal")
def test_killed_writer_leaves_the_old_map_or_the_new_one(tmp_path):
    target, folder = tmp_path / "room.map", tmp_path / "sources"
    folder.mkdir()
    sources = [folder / "a", folder / "b"]
    for source, name in zip(sources, ("old", "new"), strict=True):
        make_map(name=name).save(source)
    wholes = {source.read_bytes() for source in sources}
    rng = np.random.default_rng(0)
    for _ in range(10):
        with subprocess.Popen(
            [sys.executable, "-c", WRITER, target, SCHEMA, *sources], stdout=subprocess.PIPE
        ) as writer:
            for _ in range(int(rng.integers(1, 4))):
                writer.stdout.readline()
            try:
                writer.wait(rng.uniform(0, 0.03))
            except subprocess.TimeoutExpired:
                os.kill(writer.pid, signal.SIGKILL)
        assert writer.returncode == -signal.SIGKILL
        assert target.read_bytes() in wholes
    assert FieldMap.load(target).survey.name in {"old", "new"}
    left = {p.name for p in tmp_path.iterdir()} - {"room.map", "sources"}
    assert all(name.startswith(".room.map.tmp-") for name in left)


def test_archive_gives_back_what_the_record_wrote(saved, spline_map):
    attributes, arrays = read_archive(saved, SCHEMA)
    assert attributes["hyperparameters"] == spline_map.hyperparameters.as_dict()
    assert np.array_equal(arrays["tile.0.0.0"], spline_map.posterior.weights)
