# SPDX-License-Identifier: BSD-3-Clause
"""Sessions that several tests look at: made once."""

from types import SimpleNamespace

import pytest

from drifting import Place, drifting_walk, give_numbers
from magmatch.slam.run import slam


@pytest.fixture(scope="module", autouse=True)
def _numbers_are_given():
    """Maps of sessions are made at once; that their numbers are chosen, the tests of the command show."""
    with pytest.MonkeyPatch.context() as patch:
        give_numbers(patch)
        yield


@pytest.fixture(scope="session")
def lone():
    """One log, twice round."""
    log, truth = drifting_walk(Place(1), 1)
    return SimpleNamespace(log=log, truth=truth, session=slam(log))


@pytest.fixture(scope="session")
def many_laps():
    """One log, five times round: its last windows have several earlier passes beside them."""
    log, truth = drifting_walk(Place(2), 4, laps=5.0, scale=0.0)
    return SimpleNamespace(log=log, truth=truth, session=slam(log))


@pytest.fixture(scope="session")
def three():
    """Two logs of one place, each in a frame of its own, and one of another place."""
    a, p_a = drifting_walk(Place(1), 1, name="a.csv")
    b, p_b = drifting_walk(Place(1), 2, laps=1.2, start=2.0, name="b.csv")
    stranger, p_c = drifting_walk(Place(9), 3, laps=0.8, name="c.csv")
    logs = [a, b, stranger]
    return SimpleNamespace(logs=logs, truth=[p_a, p_b, p_c], session=slam(logs))
