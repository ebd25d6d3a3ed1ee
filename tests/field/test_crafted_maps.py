# SPDX-License-Identifier: BSD-3-Clause
"""A map made to deceive, with a manifest that fits, is refused in one line that names the entry."""

import hashlib
import json
import zipfile

import google_crc32c
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.field.storage.archive import MANIFEST
from magmatch.field.storage.store import MapRecord
from magmatch.field.tiles.tile_fit import FitError


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of a small saved map."""
    rng = np.random.default_rng(0)
    p = rng.uniform(0, [2.0, 1.5, 0.5], (60, 3))
    b = 4e-5 + 1e-5 * np.stack([np.sin(p[:, 0]), np.cos(p[:, 1]), np.sin(p[:, 2] + p[:, 0])], axis=1)
    config = FieldConfig(lengthscale=0.8, signal_sd=1e-5, noise_sd=1e-7, spacing=0.5)
    path = tmp_path_factory.mktemp("maps") / "m"
    build_map(Survey(p, b, np.arange(60.0), Rotation.random(60, rng=rng)), config).save(path)
    return path.read_bytes()


@pytest.fixture
def saved(whole, tmp_path):
    (tmp_path / "room.map").write_bytes(whole)
    return tmp_path / "room.map"


def refusal(path):
    """The message with which a file is refused: one line that names the file."""
    with pytest.raises(DataFormatError) as caught:
        FieldMap.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def repack(path, change, *, compression=zipfile.ZIP_STORED):
    """Change the entries of a map and write it with a manifest that fits them, as an attacker would."""
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    manifest = json.loads(entries.pop(MANIFEST))
    change(entries)
    manifest["attributes"]["entries"] = {
        name: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        for name, content in entries.items()
    }
    entries[MANIFEST] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return path


def edit_json(name, *keys_and_value):
    """Change one value in one JSON entry."""
    *keys, last, value = keys_and_value

    def change(entries):
        whole = part = json.loads(entries[name])
        for key in keys:
            part = part[key]
        part[last] = value
        entries[name] = json.dumps(whole).encode()

    return change


def edit_array(name, at, value):
    """Change one number of one array, checksum of the chunk included."""

    def change(entries):
        key = next(k for k in entries if k.startswith(f"{name}/c/"))
        numbers = np.frombuffer(entries[key][:-4], "<f8").copy()
        numbers[at] = value
        block = numbers.tobytes()
        entries[key] = block + int(google_crc32c.value(block)).to_bytes(4, "little")

    return change


def rename(old, new):
    return lambda entries: entries.__setitem__(new, entries.pop(old))


def rename_tile(new):
    """Give the only tile another name, in the attributes too."""

    def change(entries):
        root = json.loads(entries["zarr.json"])
        root["attributes"]["tiles"] = {new: ""}
        entries["zarr.json"] = json.dumps(root).encode()
        for name in [name for name in entries if name.startswith("tile.0.0.0/")]:
            entries[name.replace("tile.0.0.0", new)] = entries.pop(name)

    return change


CRAFTED = {
    "path out of the folder": (lambda e: e.update({"../../evil": b""}), "entry that no map has: '../../evil'"),
    "absolute path": (lambda e: e.update({"/etc/passwd": b""}), "entry that no map has"),
    "pickle": (lambda e: e.update({"positions.0/data.pkl": b""}), "entry that no map has"),
    "chunk missing": (lambda e: e.pop("times.0/c/0"), "times.0/zarr.json': expected 1 chunks, found 0"),
    "chunk too many": (lambda e: e.update({"times.0/c/1": b""}), "times.0/zarr.json': expected 1 chunks, found 2"),
    "chunk elsewhere": (rename("times.0/c/0", "times.0/c/5"), "'times.0/c/0' is missing"),
    "chunk too short": (lambda e: e.update({"times.0/c/0": b"1234"}), "'times.0/c/0' is missing or of the wrong"),
    "chunk checksum": (lambda e: e.update({"times.0/c/0": bytes(60 * 8 + 4)}), "checksum"),
    "array missing": (lambda e: [e.pop(k) for k in list(e) if k.startswith("tile.")], "'tile.0.0.0' is missing"),
    "metadata missing": (lambda e: e.pop("tile.0.0.0/zarr.json"), "entry 'tile.0.0.0/zarr.json' is missing"),
    "root missing": (lambda e: e.pop("zarr.json"), "entry 'zarr.json' is missing"),
    "root not JSON": (lambda e: e.update({"zarr.json": b"{"}), "entry 'zarr.json' is not JSON"),
    "root a list": (lambda e: e.update({"zarr.json": b"[]"}), "expected a JSON object"),
    "root empty": (lambda e: e.update({"zarr.json": b"{}"}), "entry 'zarr.json' has no attributes"),
    "attributes empty": (edit_json("zarr.json", "attributes", {}), "attribute 'surveys' is missing"),
    "attributes a list": (edit_json("zarr.json", "attributes", []), "entry 'zarr.json' has no attributes"),
    "survey a number": (edit_json("zarr.json", "attributes", "surveys", 1), "expected a list"),
    "shape huge": (edit_json("tile.0.0.0/zarr.json", "shape", [10**12]), "expected a shape"),
    "shape empty and endless": (
        lambda e: edit_json("times.0/zarr.json", "shape", [0, 2**31])(e)
        or edit_json("times.0/zarr.json", "chunk_grid", "configuration", "chunk_shape", [1, 1])(e)
        or e.pop("times.0/c/0"),
        "entry 'times.0': expected an array of shape (n,), found (0, 2147483648)",
    ),
    "shape of many chunks": (edit_json("tile.0.0.0/zarr.json", "shape", [2**31]), "chunks, found 1"),
    "chunk grid odd": (edit_json("tile.0.0.0/zarr.json", "chunk_grid", []), "expected a shape"),
    "objects": (edit_json("tile.0.0.0/zarr.json", "data_type", "object"), "expected a float64 array"),
    "compressed": (edit_json("tile.0.0.0/zarr.json", "codecs", [{"name": "gzip"}]), "expected a float64 array"),
    "chunks named otherwise": (
        edit_json("tile.0.0.0/zarr.json", "chunk_key_encoding", "configuration", "separator", "."), "expected chunks",
    ),
    "positions of four columns": (edit_json("positions.0/zarr.json", "shape", [60, 4]), "chunks, found 1"),
    "positions flat": (
        lambda e: e.update({"positions.0/zarr.json": e["times.0/zarr.json"], "positions.0/c/0": e["times.0/c/0"]})
        or e.pop("positions.0/c/0/0"),
        "entry 'positions.0': expected an array of shape (n, 3)",
    ),
    "position NaN": (edit_array("positions.0", 0, np.nan), "expected finite positions"),
    "field infinite": (edit_array("field.0", 5, np.inf), "expected finite field"),
    "orientation not unit": (edit_array("orientations.0", 0, 3.0), "expected unit quaternions"),
    "position of the model changed": (edit_array("model_positions.0", 4, 0.3), "gives another field"),
    "field of the model changed": (edit_array("model_field.0", 4, 3e-5), "gives another field"),
    "tile unlisted": (edit_json("zarr.json", "attributes", "tiles", {}), "entry 'weights' is missing"),
    "tile too many": (edit_json("zarr.json", "attributes", "tiles", "tile.0.0.1", ""), "'tile.0.0.1' is missing"),
    "tile misnamed": (rename_tile("tile.0.0"), "expected names such as tile.0.-1.0"),
    "fingerprint changed": (edit_json("zarr.json", "attributes", "tiles", "tile.0.0.0", "x"), "gives another field"),
    "fingerprint a number": (edit_json("zarr.json", "attributes", "tiles", "tile.0.0.0", 1), "expected the fingerpr"),
    "transform scaled": (edit_json("zarr.json", "attributes", "T_map_model", 0, 0, 2.0), "off orthonormal"),
    "transform a word": (edit_json("zarr.json", "attributes", "T_map_model", "I"), "expected a 4x4 matrix"),
    "transform of words": (edit_json("zarr.json", "attributes", "T_map_model", 0, 0, "1"), "expected a 4x4 matrix"),
    "transform ragged": (edit_json("zarr.json", "attributes", "T_map_model", [[1] * 4] * 3), "expected a finite 4x4"),
    "prior unknown": (edit_json("zarr.json", "attributes", "config", "prior", "magic"), "config.prior"),
    "setting unknown": (edit_json("zarr.json", "attributes", "config", "colour", 1), "config.colour"),
    "number missing": (edit_json("zarr.json", "attributes", "hyperparameters", {}), "hyperparameters: expected"),
    "number unknown": (edit_json("zarr.json", "attributes", "hyperparameters", "colour", 1), "expected numbers"),
    "number a word": (edit_json("zarr.json", "attributes", "hyperparameters", "spacing", "x"), "expected numbers"),
    "noise zero": (edit_json("zarr.json", "attributes", "hyperparameters", "noise_sd", 0), "expected positive"),
    "noise NaN": (edit_json("zarr.json", "attributes", "hyperparameters", "noise_sd", np.nan), "expected positive"),
    "divergence weight negative": (
        edit_json("zarr.json", "attributes", "hyperparameters", "stiffness", -1),
        "divergence weight that is not negative",
    ),
    "reach without end": (edit_json("zarr.json", "attributes", "hyperparameters", "reach", 2000), "at most 32"),
    "nodes beyond counting": (
        edit_json("zarr.json", "attributes", "hyperparameters", "spacing", 1e-9), "too large for a spacing",
    ),
    "name a number": (edit_json("zarr.json", "attributes", "surveys", 0, "name", 1), "expected frame and name"),
    "accuracy negative": (edit_json("zarr.json", "attributes", "surveys", 0, "pose_sd", -1), "frame and name in"),
}  # fmt: skip


@pytest.mark.parametrize("case", CRAFTED)
def test_crafted_map_with_a_fitting_manifest_is_refused(saved, case):
    change, message = CRAFTED[case]
    assert message in refusal(repack(saved, change))


def test_weights_that_are_not_the_samples_own_are_refused_once_they_are_used_for_a_covariance(saved):
    field_map = FieldMap.load(repack(saved, edit_array("tile.0.0.0", slice(None), 1e-5)))
    with pytest.raises(FitError, match=r"tile 0\.0\.0: fitting its samples again gives another field"):
        field_map.covariance(field_map.survey.positions)


def test_weights_of_another_number_are_refused(saved):
    def cut(entries):
        meta = json.loads(entries["tile.0.0.0/zarr.json"])
        meta["shape"], meta["chunk_grid"]["configuration"]["chunk_shape"] = [10], [10]
        block = np.ones(10).tobytes()
        entries["tile.0.0.0/zarr.json"] = json.dumps(meta).encode()
        entries["tile.0.0.0/c/0"] = block + int(google_crc32c.value(block)).to_bytes(4, "little")

    assert "tile 0.0.0: 10 weights are stored" in refusal(repack(saved, cut))


def test_number_that_older_maps_lack_takes_its_default(saved):
    def drop(entries):
        root = json.loads(entries["zarr.json"])
        del root["attributes"]["hyperparameters"]["stiffness"]
        entries["zarr.json"] = json.dumps(root).encode()

    assert MapRecord.read(repack(saved, drop)).hyperparameters.divergence_weight == 0.0


def edit_manifest(path, change):
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    manifest = json.loads(entries[MANIFEST])
    change(manifest["attributes"])
    entries[MANIFEST] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return path


def test_map_of_a_later_version_is_refused_with_advice(saved):
    edit_manifest(saved, lambda m: m.update(schema="magmatch.map/3"))
    message = refusal(saved)
    assert "expected schema 'magmatch.map/2', found 'magmatch.map/3'" in message
    assert "update" in message


def test_entry_missing_from_the_archive_or_the_manifest_is_named(saved):
    whole = saved.read_bytes()
    edit_manifest(saved, lambda m: m["entries"].update({"extra/zarr.json": {}}))
    assert "entry 'extra/zarr.json' is missing" in refusal(saved)
    saved.write_bytes(whole)
    edit_manifest(saved, lambda m: m["entries"].pop("times.0/c/0"))
    assert "entry 'times.0/c/0' is not in the manifest" in refusal(saved)
    edit_manifest(saved, lambda m: m.update(entries=None))
    assert "lists no entries" in refusal(saved)


def test_two_entries_of_one_name_are_refused(saved):
    with pytest.warns(UserWarning, match="Duplicate name"), zipfile.ZipFile(saved, "a") as archive:
        archive.writestr("times.0/c/0", b"")
    assert "two entries of one name" in refusal(saved)


def test_zip_bomb_is_refused_before_it_is_unpacked(saved):
    repack(saved, lambda e: e.update({"tile.0.0.0/c/0": bytes(10**7)}), compression=zipfile.ZIP_DEFLATED)
    assert "is compressed or encrypted" in refusal(saved)


def test_file_beyond_the_bound_is_refused(saved, monkeypatch):
    monkeypatch.setattr("magmatch.field.storage.archive_checks.MAX_BYTES", 1000)
    assert "larger than any saved map" in refusal(saved)
