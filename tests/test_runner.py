# SPDX-License-Identifier: BSD-3-Clause
"""A result is found once: what was kept is not found again, and what was kept of anything else is not believed."""

import pickle
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch import runner as module
from magmatch.geometry import product, random_transform
from magmatch.runner import Runner, Shared, key_of
from magmatch.workers import Task
from other_process import elsewhere

done = []


@dataclass(frozen=True, eq=False)
class Pose:
    """A class that results consist of."""

    T: RigidTransform
    odds: float


def double(values):
    """Twice the values."""
    done.append(float(values.sum()))
    return 2 * values


def invert(T, odds):
    """The other way round, if there is one."""
    done.append(odds)
    return None if odds < 0 else [(3, Pose(T.inv(), odds))]


def total(values, shift):
    """Values, of which the sum is made here."""
    return values + shift


def summed(values):
    """A sum that many tasks share."""
    done.append(len(values))
    return values.sum()


@pytest.fixture(autouse=True)
def _from_the_start():
    done.clear()


def tasks_of(values):
    return [Task("a double", (one,)) for one in values]


def run_all(function, tasks, folder=None, workers=None, kinds=(), **how):
    with Runner(workers, folder, kinds) as run:
        return list(run(function, tasks, **how))


@given(st.lists(arrays(np.float64, (2, 3), elements=st.floats(-1e300, 1e300)), max_size=6), st.integers(0, 6))
@settings(max_examples=30, deadline=None)
def test_what_was_kept_is_not_found_again_and_has_the_same_bits(tmp_path_factory, values, n):
    folder = tmp_path_factory.mktemp("kept") / "kept"
    run_all(double, tasks_of(values[:n]), folder)
    known = {one.tobytes() for one in values[:n]}
    done.clear()
    found = run_all(double, tasks_of(values), folder)
    assert len(done) == sum(one.tobytes() not in known for one in values)
    assert [one.tobytes() for one in found] == [(2 * one).tobytes() for one in values]


@pytest.mark.parametrize("workers", [None, elsewhere])
def test_results_come_in_the_order_of_the_tasks_where_every_other_one_is_known(tmp_path, workers):
    values = [np.full(2, k) for k in range(70)]
    run_all(double, tasks_of(values[::2]), tmp_path / "kept")
    done.clear()
    found = run_all(double, iter(tasks_of(values)), tmp_path / "kept", workers)
    np.testing.assert_array_equal(found, 2 * np.array(values))
    assert done == [float(one.sum()) for one in values[1::2]]


def test_results_of_classes_are_kept_to_the_bit_and_so_is_that_there_is_none(tmp_path):
    rng = np.random.default_rng(0)
    tasks = [
        Task("an inverse", (product(random_transform(rng), random_transform(rng)), x)) for x in (1.5, -1.0, np.inf)
    ]
    first = run_all(invert, tasks, tmp_path / "kept", kinds=(Pose,))
    again = run_all(invert, tasks, tmp_path / "kept", kinds=(Pose,))
    assert len(done) == 3
    assert first[1] is again[1] is None
    for ((_, one),), ((_, other),) in ((first[0], again[0]), (first[2], again[2])):
        assert one.odds == other.odds
        assert one.T.as_matrix().tobytes() == other.T.as_matrix().tobytes()


def test_the_content_of_arguments_tells_tasks_apart_and_nothing_else_does():
    T, rng = RigidTransform.from_translation([1.0, 2.0, 3.0]), np.random.default_rng(0)
    pose, x = Pose(T, 0.5), rng.normal(size=(3, 4))
    same = (pose, x, [1, 2.0, None, "a"], {"b": 1, "a": 2}, Rotation.identity())
    again = (
        pickle.loads(pickle.dumps(pose)),
        np.asfortranarray(x),
        [1, np.float64(2.0), None, "a"],
        {"a": 2, "b": 1},
    )
    key = key_of(double, same)
    assert key_of(double, (*again, Rotation.identity())) == key
    assert key_of(invert, same) != key
    for k, other in enumerate([replace(pose, odds=0.25), x + 1e-12, [1, 2, None, "a"], {"b": 2, "a": 1}]):
        assert key_of(double, (*same[:k], other, *same[k + 1 :])) != key
    assert key_of(double, (x[:, :2], x[:, 2:])) != key_of(double, (x[:2], x[2:]))
    with pytest.raises(TypeError, match="expected arguments of numbers"):
        key_of(double, (object(),))


def test_another_program_believes_nothing(tmp_path, monkeypatch):
    values = [np.eye(2)]
    run_all(double, tasks_of(values), tmp_path / "kept")
    monkeypatch.setattr(module, "program", lambda: "another")
    run_all(double, tasks_of(values), tmp_path / "kept")
    assert len(done) == 2


def test_a_damaged_file_costs_what_it_held_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "KEEP_EVERY_S", -1.0)
    values = [np.full((1, 2), k) for k in range(5)]
    run_all(double, tasks_of(values), tmp_path / "kept")
    files = sorted((tmp_path / "kept").iterdir())
    assert len(files) == 5
    files[2].write_bytes(files[2].read_bytes()[:-1] + b"?")
    done.clear()
    found = run_all(double, tasks_of(values), tmp_path / "kept")
    assert len(done) == 1
    np.testing.assert_array_equal(found, 2 * np.array(values))


def test_what_was_found_before_an_interruption_is_kept(tmp_path):
    def cut_off(values):
        if values[0] == 2:
            raise KeyboardInterrupt
        return double(values)

    values = [np.array([k]) for k in range(4)]
    cut_off.__module__, cut_off.__qualname__ = double.__module__, double.__qualname__
    with pytest.raises(KeyboardInterrupt):
        run_all(cut_off, tasks_of(values), tmp_path / "kept")
    run_all(double, tasks_of(values), tmp_path / "kept")
    assert done == [0, 1, 2, 3]


def test_what_somebody_else_put_there_stays(tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    (tmp_path / "0.results").write_text("mine too")
    run_all(double, tasks_of([np.ones(1)]), tmp_path)
    assert (tmp_path / "mine.txt").read_text() == "precious"
    assert (tmp_path / "0.results").read_text() == "mine too"
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("workers", [None, elsewhere])
def test_what_tasks_share_is_made_once(workers, monkeypatch):
    monkeypatch.setattr(module, "_shelf", module.Shelf())
    shared = [Shared(summed, (np.arange(n),), n) for n in (3, 4)]
    tasks = [Task("a total", (np.full(2, k), shared[k % 2])) for k in range(6)]
    with Runner(workers) as run:
        for _ in range(2):
            np.testing.assert_array_equal(list(run(total, tasks)), [[k + (3, 6)[k % 2]] * 2 for k in range(6)])
    assert sorted(done) == [3, 4]


def test_tasks_that_share_an_argument_have_one_affinity_unless_they_are_many_and_others_have_none():
    shared = [Shared(summed, (np.arange(n),), n) for n in (3, 4)]
    some = (*shared, shared[0], np.zeros(1), *[shared[1]] * module.MOST_TOGETHER)
    tasks = [Task("a total", (np.zeros(1), one)) for one in some]
    seen = []

    def workers(function, packed):
        for one in packed:
            seen.append((one.name, one.affinity))
            yield function(one)

    run_all(total, tasks, workers=workers)
    numbers = [0, 1, 0, None, *[1] * (module.MOST_TOGETHER - 1), 2]
    assert seen == [("a total", k) for k in numbers]


def test_rigid_transforms_are_sent_as_they_are():
    rng = np.random.default_rng(0)
    sent = [product(random_transform(rng), random_transform(rng)) for _ in range(200)]
    tasks = [Task("an inverse", (T, 1.0)) for T in sent]
    back = [found[0][1].T for found in run_all(invert, tasks, workers=elsewhere)]
    assert all((T.inv().as_matrix() == U.as_matrix()).all() for T, U in zip(sent, back, strict=True))
    # What SciPy makes of them.
    assert not all((RigidTransform.from_matrix(T.as_matrix()).as_matrix() == T.as_matrix()).all() for T in sent)


def test_what_cannot_run_or_keep_anything_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(TypeError, match="run: expected a callable"):
        Runner(3)
    for place, words in ((tmp_path / "file", "is a file"), (tmp_path / "no" / "kept", "does not exist")):
        with pytest.raises(Exception, match=f"keep: .*{words}"):
            partial(Runner, keep=place)()
