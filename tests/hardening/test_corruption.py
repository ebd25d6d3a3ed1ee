# SPDX-License-Identifier: BSD-3-Clause
"""What was saved reads back as what it was or not at all, however it was damaged. `make harden` damages many."""

import json
from collections import Counter

import numpy as np
import pytest

from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.live.estimator import FieldEstimator
from magmatch.field.map import FieldMap
from magmatch.field.priors import PRIORS
from magmatch.preparation.preparation_report import PreparationReport
from magmatch.registration.result import RegistrationResult

MAPS = [f"map {prior}" for prior in sorted(PRIORS)]
LOADERS = {
    "result": RegistrationResult.load,
    "live checkpoint": FieldEstimator.load,
    "preparation report": PreparationReport.load,
}
# Where zip and JSON keep their books: few bytes, which chance would rarely hit.
MARKS = (b"PK\x01\x02", b"PK\x05\x06", b"PK\x03\x04", b'"checksum"', b'"schema"', b"sha256", b'"covariance"')


def corrupted(raw, rng):
    """Damage of the kinds that disks, cables and editors do, once or a few times."""
    data = bytearray(raw)
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        n = len(data)
        at, size = int(rng.integers(n)), int(rng.choice([1, 2, 8, 64, 512, 4096]))
        if rng.random() < 0.4:
            mark = MARKS[int(rng.integers(len(MARKS)))]
            found = [i for i in range(len(data)) if data.startswith(mark, i)] if len(data) < 50_000 else []
            found = found or [data.find(mark)]
            at = min(n - 1, max(0, int(rng.choice(found)) + int(rng.integers(60))))
        other = int(rng.integers(n))
        kind = int(rng.integers(9))
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at] = int(rng.integers(256))
        elif kind == 2:
            data[at] = rng.choice(list(b"0123456789eE+-.,:{}[]\"'aft \n"))
        elif kind == 3:
            data[at : at + size] = bytes(len(data[at : at + size]))
        elif kind == 4:
            data[at : at + size] = rng.bytes(len(data[at : at + size]))
        elif kind == 5:
            del data[at : at + size]
        elif kind == 6:
            data[at:at] = data[other : other + size]
        elif kind == 7:
            data[at : at + size] = data[other : other + len(data[at : at + size])]
        else:
            del data[at:]
        if not data:
            break
    return bytes(data)


def is_same(found, whole):
    """Whether two files say the same; a zero may lose its sign."""
    return found == whole or (whole.startswith(b"{") and json.loads(found) == json.loads(whole))


@pytest.fixture(params=[*MAPS, *LOADERS])
def saved(request, writers, tmp_path):
    """Something saved: its file, and how to load it."""
    name, path = request.param, tmp_path / "saved"
    if name in LOADERS:
        writers[name].write(0, path)
        return name, path, LOADERS[name]
    config = FieldConfig(prior=name.removeprefix("map "), lengthscale=0.8, signal_sd=1e-5, noise_sd=1e-7, spacing=0.5)
    made = request.getfixturevalue("small_survey")
    build_map(made, config).save(path)
    return name, path, FieldMap.load


@pytest.fixture(scope="session")
def small_survey(writers):
    rng = np.random.default_rng(0)
    p = rng.uniform(0, [2.0, 1.5, 0.5], (40, 3))
    b = 4e-5 + 1e-5 * np.stack([np.sin(p[:, 0]), np.cos(p[:, 1]), np.sin(p[:, 2] + p[:, 0])], axis=1)
    return Survey(p, b, np.arange(40.0))


def test_damage_never_reads_back_as_something_else(saved, n_corruptions, tmp_path):
    name, path, load = saved
    whole = path.read_bytes()
    load(path).save(path)
    assert path.read_bytes() == whole, "saving again gives the same bytes"
    rng, counts, again = np.random.default_rng(7), Counter(), tmp_path / "again"
    for _ in range(n_corruptions):
        path.write_bytes(corrupted(whole, rng))
        try:
            load(path).save(again)
        except DataFormatError:
            counts["refused"] += 1
            continue
        counts["same" if is_same(again.read_bytes(), whole) else "something else"] += 1
    print(name, dict(counts))
    assert counts["something else"] == 0
    assert counts["refused"] > 0.8 * n_corruptions
