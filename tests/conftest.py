# SPDX-License-Identifier: BSD-3-Clause
"""How many inputs the fuzz tests try, how often writers are killed and files corrupted; what fuzz tests share."""

import resource
import signal
from contextlib import contextmanager

import pytest
from hypothesis import settings

from tolerances import guard

guard()

# The same examples in each run, however slow the machine: what fails does so for everybody.
settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")

SECONDS = 20
MEBIBYTES = 700
LENGTHS = (0, 1, 0x7F, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)


@contextmanager
def within_bounds():
    """Whatever is read here takes little time and memory."""

    def give_up(*_):
        msg = f"took longer than {SECONDS} s"
        raise TimeoutError(msg)

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    old = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, old)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    assert grown < MEBIBYTES, f"grew by {grown:.0f} MiB"


def mutate(raw, rng):
    """Bytes flipped, lengths overwritten, pieces cut out, doubled, moved or cut off."""
    data = bytearray(raw)
    for _ in range(int(rng.integers(1, 4))):
        n = max(1, len(data))
        at, size = int(rng.integers(n)), int(rng.integers(1, 40))
        kind = int(rng.integers(8))
        if kind == 0:
            data[at : at + 1] = bytes([data[at] ^ (1 << int(rng.integers(8)))]) if data else b"x"
        elif kind == 1:
            data[at : at + size] = rng.bytes(size)
        elif kind == 2:
            width = int(rng.choice([2, 4, 8]))
            length = LENGTHS[int(rng.integers(len(LENGTHS)))] % (1 << 8 * width)
            data[at : at + width] = length.to_bytes(width, "little" if rng.integers(2) else "big")
        elif kind == 3:
            del data[at : at + size]
        elif kind == 4:
            data[at:at] = data[at : at + size]
        elif kind == 5:
            data[at : at + size] = bytes(size)
        elif kind == 6:
            other = int(rng.integers(n))
            data[at : at + size] = data[other : other + size]
        else:
            del data[at:]
    return bytes(data)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--fuzz", type=int, default=10, metavar="N", help="inputs per reader of tests/data/logs/test_fuzz.py"
    )
    parser.addoption("--kills", type=int, default=20, metavar="N", help="kills in tests/hardening/test_kills.py")
    parser.addoption("--corruptions", type=int, default=50, metavar="N", help="of each file in tests/hardening")


@pytest.fixture
def n_fuzz(request: pytest.FixtureRequest) -> int:
    return int(request.config.getoption("--fuzz"))


@pytest.fixture
def mutated():
    """Bytes and a generator in, damaged bytes out."""
    return mutate


@pytest.fixture
def bounded():
    """A context that fails where time or memory run away."""
    return within_bounds
