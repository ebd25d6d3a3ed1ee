# SPDX-License-Identifier: BSD-3-Clause
"""A service in a process of its own, and walks to send through it."""

import json
import os
import re
import select
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import contextmanager, suppress
from time import monotonic, sleep
from types import SimpleNamespace

import numpy as np
from websockets.sync.client import connect

from magmatch_serve.messages import write_sample

READY = re.compile(rb"Serving .* at (http://\S+)")
# Other work may keep this machine busy.
PATIENCE = 180.0


class RunningService:
    """``magmatch serve`` with its words; ended with the block that `serving` opens."""

    def __init__(self, place, *options):
        words = [sys.executable, "-m", "magmatch", "serve", str(place), "--port", "0", *map(str, options)]
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(words, stderr=subprocess.PIPE, env=environment)
        self.said = b""
        os.set_blocking(self.process.stderr.fileno(), False)
        until = monotonic() + PATIENCE
        while (found := READY.search(self.said)) is None:
            if self.process.poll() is not None or monotonic() > until:
                self.end()
                raise AssertionError(f"it did not start: {self.said.decode()}")
            select.select([self.process.stderr], [], [], 0.2)
            self.said += self.process.stderr.read() or b""
        self.url = found[1].decode()
        self.live = self.url.replace("http", "ws") + "/live"

    def words(self):
        """All that it said on stderr so far."""
        self.said += self.process.stderr.read() or b""
        return self.said.decode()

    def end(self, how=signal.SIGTERM):
        """End it, and give what it said."""
        if self.process.poll() is None:
            self.process.send_signal(how)
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(30)
            if self.process.poll() is None:
                self.process.kill()
                self.process.wait()
        with suppress(ValueError):
            self.words()
            self.process.stderr.close()
        return self.said.decode()

    def ask(self, path, body=None, headers=(), method=None):
        """Status, headers and content of an answer."""
        request = urllib.request.Request(self.url + path, body, dict(headers), method=method)
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
                return answer.status, dict(answer.headers), answer.read()
        except urllib.error.HTTPError as refused:
            with refused:
                return refused.code, dict(refused.headers), refused.read()


@contextmanager
def serving(place, *options):
    """A service for the block."""
    service = RunningService(place, *options)
    try:
        yield service
    finally:
        service.end()


@contextmanager
def client(service, key=None, headers=None, **said):
    """A connection that has said hello; gives it with its welcome."""
    with connect(service.live, proxy=None, compression=None, additional_headers=headers) as socket:
        socket.send(json.dumps({"type": "hello"} | ({} if key is None else {"key": key}) | said))
        yield SimpleNamespace(socket=socket, welcome=json.loads(socket.recv(timeout=PATIENCE)))


def samples(log):
    """Samples of a log as dicts of the JSON form."""
    q, b = log.orientations.as_quat(), log.orientations.inv().apply(log.field)
    for n, t in enumerate(log.times):
        yield {
            "t": float(t), "position": log.positions[n].tolist(), "orientation": q[n].tolist(),
            "field": b[n].tolist(),
        }  # fmt: skip


def packed(sample):
    """A sample in the binary form."""
    return write_sample(*(np.array(sample[key]) for key in ("t", "position", "orientation", "field")))


def wait_until(condition, patience=PATIENCE):
    """Wait for something, not for ever."""
    until = monotonic() + patience
    while not (found := condition()):
        assert monotonic() < until
        sleep(0.1)
    return found
