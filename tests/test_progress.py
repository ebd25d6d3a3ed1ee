# SPDX-License-Identifier: BSD-3-Clause
"""Claims about what verbs tell while they work."""

import numpy as np
import pytest

import magmatch as mm
from magmatch.field.config import SPLINE
from magmatch.field.query import query_map
from magmatch.progress import counted, followed, tell
from magmatch.simulation.config import SimulationConfig
from magmatch.threads import side_by_side


@pytest.fixture(scope="module")
def pair():
    return mm.simulate("office", 3, SimulationConfig(n_samples=300))


class Heard(list):
    def __call__(self, what, share):
        assert share is None or 0 <= share <= 1
        self.append((what, share))


@pytest.mark.slow
def test_every_verb_tells_the_same_callback_and_gives_the_same_answer(pair, tmp_path):
    turned = mm.simulate("office-hand-held", 3, SimulationConfig(n_samples=300)).target
    calls = {
        "map": lambda heard: mm.build_map(pair.base, SPLINE, progress=heard),
        "register": lambda heard: mm.register(pair.base, pair.target, progress=heard),
        "prepare": lambda heard: mm.prepare(turned, progress=heard),
    }
    told = {name: Heard() for name in calls}
    given = {name: call(told[name]) for name, call in calls.items()}
    assert all(told.values())
    field_map = given["map"]
    at = pair.base.positions[:10]
    np.testing.assert_array_equal(field_map.evaluate(at).field, mm.build_map(pair.base, SPLINE).evaluate(at).field)
    field_map.save(tmp_path / "a.map")
    calls = (
        lambda heard: mm.open_atlas(tmp_path, progress=heard),
        lambda heard: query_map(field_map, at, progress=heard),
        lambda heard: mm.register(tmp_path, pair.target, progress=heard),
        lambda heard: mm.register(mm.open_atlas(tmp_path, progress=heard), pair.target, progress=heard),
    )
    for call in calls:
        call(heard := Heard())
        assert heard


def test_nobody_is_told_after_the_block_and_the_inner_follower_goes_first():
    outer, inner = Heard(), Heard()
    with followed(outer):
        tell("one")
        with followed(inner):
            tell("two")
        with followed(None):
            tell("three", 0.5)
    tell("four")
    assert outer == [("one", None), ("three", 0.5)]
    assert inner == [("two", None)]


def test_other_threads_tell_too_and_shares_rise():
    heard = Heard()
    with followed(heard):
        side_by_side(lambda k: tell("a part", k / 8), range(8))
        assert list(counted("counting", "abcd")) == list("abcd")
    assert sorted(heard[:8]) == [("a part", k / 8) for k in range(8)]
    assert [share for _, share in heard[8:]] == [0, 0.25, 0.5, 0.75]


def test_what_a_callback_raises_ends_the_work(pair):
    def stop(what, share):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mm.build_map(pair.base, SPLINE, progress=stop)
