# SPDX-License-Identifier: BSD-3-Clause
"""A log is sent through the live door as if it were walked now, and the answers are collected."""

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from websockets import exceptions as errors
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError, MagmatchError, SurveyError
from magmatch.geometry import near_origin, transform_from_matrix
from magmatch_serve.live import PROTOCOL
from magmatch_serve.messages import read_pose, write_sample

# Samples on their way, and tries to connect before it is given up; seconds between tries.
WINDOW, TRIES, PAUSE = 32, 30, 1.0
PATIENCE = 60.0


class ReplayError(MagmatchError, OSError):
    """The service cannot be reached, or refuses."""


@dataclass(frozen=True, slots=True)
class Replayed:
    """The answers that came back of a log."""

    times: np.ndarray  # (k,), s: of the samples at which a pose was stated
    poses: RigidTransform | None  # those poses, ``T_map_body``
    n_answers: int
    n_errors: int  # samples that were refused


def live_url(url: str) -> str:
    """Address of the live door of a service, whose own address starts with http or ws."""
    parts = urlsplit(url)
    schemes = {"http": "ws", "ws": "ws", "https": "wss", "wss": "wss"}
    if parts.scheme not in schemes or not parts.netloc:
        msg = f"--url: expected the address of a service, such as http://127.0.0.1:8123; found '{url}'"
        raise ConfigurationError(msg)
    path = parts.path.rstrip("/")
    return f"{schemes[parts.scheme]}://{parts.netloc}{path if path.endswith('/live') else path + '/live'}"


def replay(
    log: Survey,
    url: str,
    *,
    speed: float = 1.0,
    token: str | None = None,
    on_pose: Callable[[dict[str, Any]], None] = lambda _: None,
) -> Replayed:
    """Send a log to a service, so many times faster than it was walked; a service that restarts is waited for."""
    if log.times is None:
        msg = f"{log.name}: expected a log with times, got none; add a column t (s)"
        raise SurveyError(msg)
    sender = _Sender(log, speed, on_pose)
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    for _ in range(TRIES):
        try:
            with connect(
                live_url(url), additional_headers=headers, subprotocols=[Subprotocol(PROTOCOL)], compression=None,
                max_queue=None, proxy=None, open_timeout=PATIENCE,
            ) as socket:  # fmt: skip
                sender.run(socket)
                return sender.result()
        except errors.InvalidStatus as error:
            said = _sentence(error.response.body)
            status = error.response.status_code
            msg = (
                f"{url}: refused with {status}: {said}"
                if said
                else f"{url}: no service of maps answers there ({status})"
            )
            if status != 503:
                raise ReplayError(msg) from None
        except errors.ConnectionClosed as error:
            code = 1006 if error.rcvd is None else error.rcvd.code
            if code not in {1001, 1006, 1012, 4503}:
                msg = f"{url}: closed with {code}: {error.rcvd.reason if error.rcvd else ''}"
                raise ReplayError(msg) from None
        except (OSError, TimeoutError, errors.WebSocketException) as error:
            if not sender.key:
                msg = f"{url}: no service answers there ({error})"
                raise ReplayError(msg) from None
        sleep(PAUSE)
    msg = f"{url}: no service answers there any more"
    raise ReplayError(msg)


class _Sender:
    """The state of a replay, over all its connections."""

    def __init__(self, log: Survey, speed: float, on_pose: Callable[[dict[str, Any]], None]) -> None:
        R = log.orientations if log.orientations is not None else Rotation.identity(len(log))
        assert log.times is not None
        self._times, self._q, self._b = log.times, R.as_quat(), R.inv().apply(log.field)
        # Where odometry has its origin makes no difference to the answers; single precision needs it near.
        self._p = log.positions - near_origin(log.positions, 1.0)
        self._speed, self._on_pose = speed, on_pose
        self.key = ""
        self._found: dict[float, list[list[float]]] = {}
        self._n_answers = self._n_errors = 0
        self._begun = monotonic()

    def run(self, socket: Any) -> None:
        """Send what is left, until all is answered."""
        socket.send(json.dumps({"type": "hello", "name": "replay"} | ({"key": self.key} if self.key else {})))
        welcome = json.loads(socket.recv(timeout=PATIENCE))
        self.key = welcome["key"]
        # What the service has not seen, or has forgotten, is sent again.
        known = -np.inf if welcome["t"] is None else welcome["t"]
        under_way = 0
        for n in range(int(np.searchsorted(self._times, known, side="right")), len(self._times)):
            due = self._begun + (self._times[n] - self._times[0]) / self._speed
            while under_way == WINDOW or (under_way and monotonic() < due):
                with suppress(TimeoutError):
                    self._take(socket.recv(timeout=PATIENCE if under_way == WINDOW else due - monotonic()))
                    under_way -= 1
            sleep(max(due - monotonic(), 0.0))
            socket.send(write_sample(self._times[n], self._p[n], self._q[n], self._b[n]))
            under_way += 1
        for _ in range(under_way):
            self._take(socket.recv(timeout=PATIENCE))

    def _take(self, answer: str | bytes) -> None:
        said = read_pose(answer)
        if said["type"] == "error":
            self._n_errors += 1
            return
        self._n_answers += 1
        self._found.pop(said["t"], None)
        if "T_map_body" in said:
            self._found[said["t"]] = said["T_map_body"]
        self._on_pose(said)

    def result(self) -> Replayed:
        """Give the answers that came back."""
        times = sorted(self._found)
        poses = [transform_from_matrix(np.array(self._found[t])) for t in times]
        found = RigidTransform.concatenate(poses) if poses else None
        return Replayed(np.array(times), found, self._n_answers, self._n_errors)


def _sentence(body: bytes | bytearray | None) -> str:
    try:
        return str(json.loads(body or b"")["message"])
    except (ValueError, KeyError, TypeError):
        return ""
