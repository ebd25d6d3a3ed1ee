# SPDX-License-Identifier: BSD-3-Clause
"""Whole logs on a Dask cluster: right answers, maps held in memory, and what is said when parts of it die."""

import asyncio
import json
from contextlib import ExitStack, contextmanager

import pytest

from magmatch.errors import ConfigurationError
from magmatch_serve.config import ServeConfig
from magmatch_serve.logs.work import _place
from magmatch_serve.service import Service
from serving import serving, wait_until

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore")
WORK = {"n_workers": 1, "threads_per_worker": 2, "dashboard_address": None, "silence_logs": 50}


@contextmanager
def cluster(port=0, *, processes=True):
    with distributed.LocalCluster(host="127.0.0.1", scheduler_port=port, processes=processes, **WORK) as one:
        yield one


def asked(service, body):
    status, headers, said = service.ask("/localize", body)
    return status, headers, json.loads(said)


@pytest.mark.slow
def test_logs_are_worked_on_by_a_cluster_that_holds_the_maps_and_may_die(hall, tmp_path):
    log = hall.walk(2)[0]
    log.save(tmp_path / "log.csv")
    body = (tmp_path / "log.csv").read_bytes()
    with ExitStack() as outlasting:
        with cluster() as one:
            address, port = one.scheduler_address, int(one.scheduler_address.rpartition(":")[2])
            words = ("--workers", f"dask://{address}", "--states", tmp_path / "states")
            service = outlasting.enter_context(serving(hall.map, *words))
            first, again = asked(service, body), asked(service, body)
            assert (first[0], first[2]["status"], first[2]["map"]) == (200, "localized", again[2]["map"])
            assert first[2]["trajectory"] == again[2]["trajectory"]
            with distributed.Client(address, set_as_default=False) as client:
                (held,) = client.run(lambda: tuple(_place.cache_info())).values()
                assert held[:2] == (1, 1)  # read once, found in memory once
        # The scheduler is gone.
        status, headers, said = asked(service, body)
        assert (status, said["message"].count("\n"), "retry-after" in headers) == (503, 0, True)
        assert service.ask("/health")[0] == 200
        with cluster(port, processes=False):  # at hand at once
            assert wait_until(lambda: (now := asked(service, body))[0] == 200 and now)[2]["status"] == "localized"


def test_a_cluster_that_is_not_there_is_said_so_before_maps_are_loaded(hall, tmp_path, monkeypatch):
    monkeypatch.setattr("magmatch_serve.logs.workers.CONNECT_WITHIN", 0.2)
    service = Service(hall.map, ServeConfig(states=tmp_path / "states", dask="tcp://127.0.0.1:9"))

    async def run():
        async with service.running():
            pass

    with pytest.raises(ConfigurationError, match="expected a Dask scheduler"):
        asyncio.run(run())
    assert not hasattr(service, "trackers")
