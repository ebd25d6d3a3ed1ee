# SPDX-License-Identifier: BSD-3-Clause
"""Parts run side by side give the same bits, and their faults come through."""

import contextvars
import sys
import threading
import time

import numpy as np
import pytest

from magmatch.field.cholesky.selected_inverse import selected_inverse
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline.spline_model import SplineModel
from magmatch.threads import on_one_core, side_by_side


def test_a_fault_in_a_part_is_raised():
    def fail(part):
        if part == 1:
            msg = "pivot 3"
            raise np.linalg.LinAlgError(msg)

    with pytest.raises(np.linalg.LinAlgError, match="pivot 3"):
        side_by_side(fail, range(2))
    with pytest.raises(np.linalg.LinAlgError, match="pivot 3"):
        on_one_core(side_by_side, fail, range(2))


def test_parts_of_parts_never_take_more_cores_than_there_are(monkeypatch):
    monkeypatch.setattr("magmatch.threads._spare_cores", threading.Semaphore(2))
    lock, running, most = threading.Lock(), [0], [0]

    def leaf(_):
        with lock:
            running[0] += 1
            most[0] = max(most[0], running[0])
        time.sleep(0.005)
        with lock:
            running[0] -= 1

    # The first parts are done early, and their cores go to those within the last.
    side_by_side(lambda k: side_by_side(leaf, range(1 + 8 * k)), range(4))
    assert most[0] == 3
    side_by_side(leaf, range(6))
    assert most[0] == 3


def test_cores_come_back_from_parts_that_fail(monkeypatch):
    monkeypatch.setattr("magmatch.threads._spare_cores", spare := threading.Semaphore(2))
    for _ in range(3):
        with pytest.raises(ZeroDivisionError):
            side_by_side(lambda k: 1 / (k - 1), range(5))
    assert [spare.acquire(blocking=False) for _ in range(3)] == [True, True, False]


def test_limits_of_a_task_hold_for_its_parts():
    assert on_one_core(side_by_side, lambda _: threading.get_ident(), range(3)) == [threading.get_ident()] * 3
    context = contextvars.ContextVar("context", default=0)
    context.set(7)
    assert side_by_side(lambda _: context.get(), range(3)) == [7, 7, 7]


def test_factor_and_inverse_have_the_same_bits_on_one_core_and_on_several():
    rng = np.random.default_rng(0)
    x, b = rng.uniform(0, [3, 2, 1], (800, 3)), 1e-5 * rng.normal(size=(800, 3))
    model = SplineModel.over(x, Hyperparameters(0.5, 1e-5, 1e-6, 0.25, 100.0))
    assert len(model.elimination.branches) == 2
    information = model.observe(x, b)
    several = model.infer(information)
    one = on_one_core(model.infer, information)
    assert np.array_equal(several.weights, one.weights)
    inverse = on_one_core(selected_inverse, one.factors.full)
    assert np.array_equal(selected_inverse(several.factors.full).stencil, inverse.stencil)


def test_threads_take_turns_as_before_once_all_parts_are_done(monkeypatch):
    monkeypatch.setattr("magmatch.threads._spare_cores", threading.Semaphore(2))
    before = sys.getswitchinterval()

    def fail(k):
        assert sys.getswitchinterval() < before
        side_by_side(abs, range(3))
        assert sys.getswitchinterval() < before
        return 1 / k

    with pytest.raises(ZeroDivisionError):
        side_by_side(fail, range(3))
    assert sys.getswitchinterval() == before


def test_no_part_begins_after_a_fault(monkeypatch):
    monkeypatch.setattr("magmatch.threads._spare_cores", threading.Semaphore(1))
    begun, is_failed = [], threading.Event()

    def part(k):
        begun.append(k)
        if threading.current_thread() is threading.main_thread():
            is_failed.set()
            raise KeyboardInterrupt
        is_failed.wait(10)
        time.sleep(0.05)

    with pytest.raises(KeyboardInterrupt):
        side_by_side(part, range(100))
    assert len(begun) <= 3
