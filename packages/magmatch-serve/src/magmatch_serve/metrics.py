# SPDX-License-Identifier: BSD-3-Clause
"""The service counts, and says so in the text form of Prometheus."""

from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
SECONDS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)


class Metrics:
    """Counters of one service."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        own: dict[str, Any] = {"registry": self.registry}
        self.clients = Gauge("magmatch_clients", "Clients that are connected", **own)
        self.messages = Counter("magmatch_messages", "Messages of samples that were answered with an estimate", **own)
        self.wait = Histogram(
            "magmatch_answer_seconds",
            "From the arrival of a message of samples to its answer",
            buckets=SECONDS,
            **own,
        )
        self.refused = Counter("magmatch_refused", "What could not be done, by its status", ["status"], **own)
        self.logs = Counter("magmatch_logs", "Whole logs that were worked on", ["verb"], **own)
        self.restarts = Gauge("magmatch_tracker_restarts", "Trackers that died and were started again", **own)
        self.maps = Gauge("magmatch_maps", "Maps that are served", **own)
        self.fault = Gauge("magmatch_map_fault", "1 while newer maps cannot be served; /maps says why", **own)
        self.renewals = Counter("magmatch_map_renewals", "Times that maps were loaded again", **own)

    def text(self) -> bytes:
        """Write all counters."""
        return generate_latest(self.registry)
