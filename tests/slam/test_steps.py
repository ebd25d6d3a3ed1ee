# SPDX-License-Identifier: BSD-3-Clause
"""Steps that were kept are not taken again, and what was kept of anything else is not believed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from magmatch.slam import steps as module
from magmatch.slam.steps import Steps


def taken(steps, results):
    """What steps give, and which of them were taken."""
    done = []

    def step(k):
        done.append(k)
        return results[k]

    return [steps(lambda k=k: step(k)) for k in range(len(results))], done


@given(st.lists(arrays(np.float64, (2, 3), elements=st.floats(-1e300, 1e300)), max_size=6), st.integers(0, 6))
@settings(max_examples=30, deadline=None)
def test_the_same_steps_go_on_where_they_were_cut_off_with_the_same_bits(tmp_path_factory, results, n):
    folder = tmp_path_factory.mktemp("steps") / "kept"
    first = Steps(folder, of=1)
    taken(first, results[:n])
    first.keep()
    found, done = taken(Steps(folder, of=1), results)
    assert done == list(range(min(n, len(results)), len(results)))
    for one, other in zip(found, results, strict=True):
        assert one.tobytes() == other.tobytes()


def test_steps_of_something_else_are_deleted(tmp_path):
    steps = Steps(tmp_path / "kept", inputs=["a"])
    taken(steps, [np.eye(2)])
    steps.keep()
    assert taken(Steps(tmp_path / "kept", inputs=["b"]), [np.zeros((1, 1))])[1] == [0]
    assert not (tmp_path / "kept").exists()


def test_a_file_that_was_damaged_ends_what_is_known(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "KEEP_EVERY_S", -1.0)
    results = [np.full((1, 2), k) for k in range(5)]
    taken(Steps(tmp_path / "kept", of=1), results)
    assert len(list((tmp_path / "kept").iterdir())) == 5
    (tmp_path / "kept" / "2.json").write_text("{")
    found, done = taken(Steps(tmp_path / "kept", of=1), results)
    assert done == [2, 3, 4]
    np.testing.assert_array_equal(np.concatenate(found), np.concatenate(results))


def test_without_a_folder_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    steps = Steps()
    taken(steps, [np.eye(2)])
    steps.keep()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("empty", [np.zeros((0, 123))])
def test_a_step_that_found_nothing_was_taken_too(tmp_path, empty):
    steps = Steps(tmp_path / "kept", of=1)
    taken(steps, [empty, empty])
    steps.keep()
    assert taken(Steps(tmp_path / "kept", of=1), [empty, empty, np.eye(2)])[1] == [2]


def test_what_somebody_else_put_there_stays(tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    Steps(tmp_path, of=1)(lambda: np.ones((1, 1)))
    Steps(tmp_path, of=2)
    assert (tmp_path / "mine.txt").read_text() == "precious"
