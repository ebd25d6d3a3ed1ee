# SPDX-License-Identifier: BSD-3-Clause
"""Saved records, settings and points with mutated content whose checksums fit: read, or one known error.

`make fuzz` tries many. Without fitting checksums nearly all mutants would be refused before anything reads them.
"""

import json
import logging
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from crafted import apart, together
from magmatch.cli.settings import read_settings, registration_config
from magmatch.data.formats.csv import read_points
from magmatch.data.formats.extrinsic import read_extrinsic
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.survey import Survey
from magmatch.errors import MagmatchError
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.live.estimator import FieldEstimator
from magmatch.field.map import FieldMap
from magmatch.preparation.preparation_report import PreparationReport
from magmatch.registration.result import RegistrationResult

NUMBERS = (0, -1, 1, 3, 1e-300, 1e-9, 1e9, 1e300, 2**31, 2**63, 10**30, None, True, "x", [], {}, [[]], float("nan"))


def changed_json(content, rng):
    """One value of a JSON document replaced, removed or doubled."""
    places = []

    def walk(part):
        for key in part if isinstance(part, dict) else range(len(part)):
            places.append((part, key))
            if isinstance(part[key], dict | list) and part[key]:
                walk(part[key])

    walk(content)
    if not places:
        return
    part, key = places[int(rng.integers(len(places)))]
    kind = int(rng.integers(4))
    if kind == 0:
        del part[key]
    elif kind == 1 and isinstance(part, list):
        part.append(part[key])
    elif kind == 2 and isinstance(part[key], int | float):
        part[key] *= float(rng.choice([-1, 0.5, 2, 1e3, 1e6, 1e-6]))
    else:
        part[key] = NUMBERS[int(rng.integers(len(NUMBERS)))]


def changed_store(raw, rng):
    """A saved file of which values, entries of the header or numbers of arrays are changed, and the digests fit."""
    about, header, content, data = apart(raw)
    for _ in range(int(rng.integers(1, 3))):
        kind = rng.random()
        if kind < 0.5:
            changed_json(content, rng)
        elif kind < 0.6:
            changed_json(header, rng)
        else:
            numbers = np.frombuffer(data, "<f8").copy()
            at = rng.integers(len(numbers), size=int(rng.choice([1, 3, 30])))
            numbers[at] = rng.choice([0.0, 1.0, -1e-5, 1e-300, 1e9, 1e300, np.nan, np.inf, numbers[at[0]] * 1.01])
            data = numbers.tobytes()
    return together(about, header, content, data)


def changed_document(raw, rng):
    """Values of a result or report changed, without the checksum."""
    content = json.loads(raw)
    content.pop("checksum", None)
    for _ in range(int(rng.integers(1, 3))):
        changed_json(content, rng)
    return json.dumps(content).encode()


def use_map(path):
    field_map = FieldMap.load(path)
    points = field_map.survey.positions[:3]
    assert np.isfinite(field_map.evaluate(points, 1).field).all()


def use_settings(path):
    read_settings(path)
    registration_config("default", path)


SETTINGS = b"field: {prior: spline, lengthscale: 0.5, domain: [0, 0, 0, 5, 4, 3]}\nsearch: keypoints\n"
EXTRINSIC = b"transform:\n  translation: {x: 0.1, y: 0.0, z: 0.3}\n  rotation: {x: 0.0, y: 0.0, z: 0.6, w: 0.8}\n"
POINTS = b"x,y,z,name\n0,1,2,a\n0.5,1e-3,-2,b\n3,4,5,c\n"
READERS = {
    "map": (use_map, changed_store),
    "live checkpoint": (FieldEstimator.load, changed_store),
    "result": (RegistrationResult.load, changed_document),
    "preparation report": (PreparationReport.load, changed_document),
    "settings": (use_settings, None),
    "extrinsic": (lambda path: read_extrinsic(str(path)), None),
    "points": (lambda path: read_points(path, SurveyFormat()), None),
}


@pytest.fixture(scope="module")
def seeds(writers, tmp_path_factory):
    """One whole file for each reader."""
    folder = tmp_path_factory.mktemp("records")
    rng = np.random.default_rng(0)
    p = rng.uniform(0, [1.0, 0.8, 0.3], (14, 3))
    b = 4e-5 + 1e-5 * np.stack([np.sin(p[:, 0]), np.cos(p[:, 1]), np.sin(p[:, 2] + p[:, 0])], axis=1)
    config = FieldConfig(prior="spline", lengthscale=0.8, signal_sd=1e-5, noise_sd=1e-7, spacing=0.5)
    build_map(Survey(p, b, np.arange(14.0)), config).save(folder / "map")
    estimator = FieldEstimator(Hyperparameters(0.5, 1e-5, 5e-7, 0.25, 1.0))
    estimator.update(p, b)
    estimator.save(folder / "live checkpoint")
    for name in ("result", "preparation report"):
        writers[name].write(0, folder / name)
    for name, content in {"settings": SETTINGS, "extrinsic": EXTRINSIC, "points": POINTS}.items():
        (folder / name).write_bytes(content)
    return folder


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # absurd numbers overflow on the way to being refused
@pytest.mark.parametrize("name", READERS)
def test_mutated_records_end_in_themselves_or_a_known_error(name, seeds, tmp_path, n_fuzz, mutated, bounded, caplog):
    caplog.set_level(logging.CRITICAL, logger="magmatch")
    use, change = READERS[name]
    rng, raw, path = np.random.default_rng(len(name)), (seeds / name).read_bytes(), tmp_path / "file.yaml"
    use(seeds / name)
    for _ in range(n_fuzz):
        path.write_bytes((change or partial(mutated))(raw, rng))
        words = ""
        try:
            with bounded():
                use(path)
        except MagmatchError as error:
            words = str(error)
        except BaseException:
            (Path("fuzz-failure") if n_fuzz > 1000 else path).write_bytes(path.read_bytes())
            raise
        assert "\n" not in words
        assert len(words) < 1500
