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
    return found == whole or json.loads(found) == json.loads(whole)


@pytest.fixture(params=LOADERS)
def saved(request, writers, tmp_path):
    """Something saved: its file, and how to load it."""
    writers[request.param].write(0, tmp_path / "saved")
    return request.param, tmp_path / "saved", LOADERS[request.param]


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
