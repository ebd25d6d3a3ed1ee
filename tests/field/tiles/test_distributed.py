# SPDX-License-Identifier: BSD-3-Clause
"""Tiles fitted by other processes: the same bits, also where workers die; a poisoned task ends in one clear line."""

import contextlib
import os
import signal
import socketserver
import sys
import threading

import numpy as np
import pytest

from magmatch.errors import ConfigurationError, MissingExtraError, TaskError
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.tiles.region_model import TiledModel
from magmatch.field.tiles.tile_fit import fit_weights
from magmatch.field.tiles.tiles import Tiling
from magmatch.runner import Runner
from magmatch.workers import DaskRunner

pytest.importorskip("distributed")
H = Hyperparameters(0.6, 4e-6, 5e-7, 0.2, 300.0)


@pytest.fixture(scope="module", autouse=True)
def _send_functions_of_this_file_by_value():
    cloudpickle = pytest.importorskip("cloudpickle")
    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    yield
    cloudpickle.unregister_pickle_by_value(sys.modules[__name__])


@pytest.fixture(scope="module")
def tasks():
    rng = np.random.default_rng(0)
    x = rng.uniform(0, [8, 0.3, 0.1], (400, 3))
    model = TiledModel.over(x, H, Tiling(0.2, 5, 2, core=8))
    tasks = model.tasks(model.observe(x, 1e-5 * np.sin(x)))
    return [tasks.task(k).as_task for k in range(len(model.tiles))]


@pytest.fixture(scope="module")
def workers():
    with DaskRunner(jobs=2) as run:
        yield Runner(run)


def fails(task):
    """Raise on the third tile."""
    if task.index[0] == 2:
        msg = "pivot 7 of 9\nfails"
        raise ValueError(msg)
    return fit_weights(task)


def dies(task):
    """Kill whoever works on the third tile."""
    if task.index[0] == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return fit_weights(task)


def dies_once(task, flag):
    """Kill the first worker that takes up the third tile, in the middle of it."""
    if task.index[0] == 2 and not flag.exists():
        fit_weights(task)
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return fit_weights(task)


def test_workers_give_the_same_bits_and_one_that_dies_changes_nothing(workers, tasks, tmp_path):
    flag = tmp_path / "died"
    here = [fit_weights(*task.arguments) for task in tasks]
    there = list(workers(lambda task: dies_once(task, flag), iter(tasks)))
    assert flag.exists()
    assert all(np.array_equal(a, b) for a, b in zip(here, there, strict=True))


def test_task_that_raises_ends_in_one_line_and_the_workers_go_on(workers, tasks):
    with pytest.raises(TaskError, match=r"^tile 2\.-?\d\.-?\d failed on a worker: pivot 7 of 9 fails$"):
        list(workers(fails, tasks))
    assert np.array_equal(next(workers(fit_weights, tasks[:1])), fit_weights(*tasks[0].arguments))


def test_few_tasks_are_on_their_way_at_any_time(workers, tasks):
    taken = []
    results = workers(lambda task: len(task.around), (taken.append(k) or tasks[0] for k in range(100)))
    next(results)
    assert len(taken) <= 10
    results.close()


def test_scheduler_that_does_not_answer_is_named(tasks, monkeypatch):
    monkeypatch.setattr("magmatch.workers.CONNECT_SECONDS", 0.3)
    with (
        DaskRunner(scheduler="tcp://127.0.0.1:9") as run,
        pytest.raises(ConfigurationError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"),
    ):
        next(run(fit_weights, tasks))


class AnotherServer(socketserver.BaseRequestHandler):
    """A server that answers each who comes as a web server answers a stranger."""

    def handle(self):
        with contextlib.suppress(ConnectionError):
            self.request.recv(1)
            self.request.sendall(b"HTTP/1.1 400 Bad Request")


def test_another_server_at_the_address_is_no_scheduler(tasks):
    with socketserver.TCPServer(("127.0.0.1", 0), AnotherServer) as server:
        threading.Thread(target=server.serve_forever, args=[0.05]).start()
        run = DaskRunner(scheduler=f"tcp://127.0.0.1:{server.server_address[1]}")
        try:
            with run, pytest.raises(ConfigurationError, match="no Dask scheduler answers"):
                next(run(fit_weights, tasks))
        finally:
            server.shutdown()  # returns once the thread has left its loop: it never meets a closed socket


def test_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"pip install '\.\[distributed\]'"):
        DaskRunner()


@pytest.mark.parametrize("jobs", [0, 1.5])
def test_a_number_of_processes_that_cannot_be_is_refused_at_once(jobs):
    with pytest.raises((TypeError, ValueError), match="jobs: expected a whole number from 1"):
        DaskRunner(jobs=jobs)


@pytest.mark.slow
def test_task_that_kills_every_worker_is_given_up(workers, tasks):  # last: workers are still coming back after it
    with pytest.raises(TaskError, match=r"^tile 2\.-?\d\.-?\d took down several workers one after the other"):
        list(workers(dies, tasks))
