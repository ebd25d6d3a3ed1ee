# SPDX-License-Identifier: BSD-3-Clause
"""A result reads back as what it was or not at all, however it was damaged (saved maps and states: test_store.py)."""

import json
from collections import Counter

import numpy as np
import pytest

from magmatch.errors import DataFormatError
from magmatch.preparation.preparation_report import PreparationReport
from magmatch.registration.result import RegistrationResult

LOADERS = {"result": RegistrationResult.load, "preparation report": PreparationReport.load}
# Where the books are kept: few bytes, which chance would rarely hit.
MARKS = (b'"checksum"', b'"schema"', b"sha256", b'"covariance"')


def corrupted(raw, rng, mutate):
    """The file damaged anywhere, or right behind a mark."""
    if rng.random() < 0.6:
        return mutate(raw, rng)
    places = [i for mark in MARKS if (i := raw.find(mark)) >= 0]
    at = int(rng.choice(places)) + int(rng.integers(60))
    return raw[:at] + mutate(raw[at : at + 60], rng) + raw[at + 60 :]


def is_same(found, whole):
    """Whether two files say the same; a zero may lose its sign."""
    return found == whole or json.loads(found) == json.loads(whole)


@pytest.fixture(params=LOADERS)
def saved(request, writers, tmp_path):
    """Something saved: its file, and how to load it."""
    writers[request.param].write(0, tmp_path / "saved")
    return request.param, tmp_path / "saved", LOADERS[request.param]


def test_damage_never_reads_back_as_something_else(saved, n_corruptions, mutated, tmp_path):
    name, path, load = saved
    whole = path.read_bytes()
    load(path).save(path)
    assert path.read_bytes() == whole, "saving again gives the same bytes"
    rng, counts, again = np.random.default_rng(7), Counter(), tmp_path / "again"
    for _ in range(n_corruptions):
        path.write_bytes(corrupted(whole, rng, mutated))
        try:
            load(path).save(again)
        except DataFormatError:
            counts["refused"] += 1
            continue
        counts["same" if is_same(again.read_bytes(), whole) else "something else"] += 1
    print(name, dict(counts))
    assert counts["something else"] == 0
    assert counts["refused"] > 0.8 * n_corruptions
