# SPDX-License-Identifier: BSD-3-Clause
"""A process that follows some of the clients: messages in by a pipe, answers out, states to the disk now and then."""

import gc
import logging
import select
import signal
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from magmatch.atomic import write_whole
from magmatch.errors import MagmatchError
from magmatch.estimation.limits import MAX_LOADED
from magmatch.geometry import path_walked
from magmatch.localization.known_places import KnownPlaces, NotReadyError, open_place
from magmatch.threads import one_blas_thread
from magmatch_serve.bodies import checkpoints
from magmatch_serve.bodies.body import Body
from magmatch_serve.config import ServeConfig
from magmatch_serve.messages import write_sample
from magmatch_serve.refusals import RefusedError

log = logging.getLogger("magmatch.serve")
# Seconds for which a body whose client left stays in memory, and between two looks at what is due.
LINGER, TICK = 60.0, 0.1
# A batch that took so long, s, begins no second search, which would take several times longer: others wait for it.
SEARCH_WITHIN = 0.005


def run_tracker(pipe: Connection, place: Path, config: ServeConfig) -> None:
    """Follow clients until told to stop, or until the service is gone."""
    for stop in (signal.SIGINT, signal.SIGTERM):  # the service says when, also where all are told
        signal.signal(stop, signal.SIG_IGN)
    with one_blas_thread():
        try:
            known = load_places(place)
            rehearse(known, config)
            tracker = Tracker(known, place, config)
        except (MagmatchError, OSError) as error:
            pipe.send(error)
            return
        pipe.send(None)
        # Everything that exists by now stays: the collector need not look through it again.
        gc.freeze()
        # The pipe's own way to wait makes a selector each time.
        arrival = select.poll()
        arrival.register(pipe.fileno(), select.POLLIN)
        try:
            while True:
                if arrival.poll(1000 * TICK):
                    request = pipe.recv()
                    if request is None:
                        break
                    pipe.send(tracker.answers(request))
                tracker.keep_up()
        except (EOFError, OSError):
            pass
        finally:
            tracker.close()


def load_places(path: Path) -> KnownPlaces:
    """Maps, those of a small folder made ready ahead of the first body."""
    known = KnownPlaces(open_place(path))
    if len(known.entries) <= MAX_LOADED:
        for entry in known.entries:
            known.of(entry)
    return known


def rehearse(known: KnownPlaces, config: ServeConfig) -> None:
    """Walk along a map's own samples, so that no client waits until loops are compiled or read from the cache."""
    first = known.of(known.entries[0])
    survey = first.index.field_map.survey
    n = int(np.searchsorted(path_walked(survey.positions), config.localizer.window * first.length))
    body = Body(known, config.localizer, is_binary=True)
    for k, (p, b) in enumerate(zip(survey.positions[:n], survey.field[:n], strict=True)):
        with suppress(RefusedError):
            body.take(write_sample(float(k), p, np.array([0.0, 0.0, 0.0, 1.0]), b), 1)


class Tracker:
    """Bodies by their clients' ids."""

    def __init__(self, known: KnownPlaces, place: Path, config: ServeConfig) -> None:
        self._known, self._place, self._config = known, place, config
        self._bodies: OrderedDict[str, Body] = OrderedDict()
        self._writer, self._loader = ThreadPoolExecutor(1), ThreadPoolExecutor(1)
        known.loader = self._loader
        self._loading: Future[KnownPlaces] | None = None
        self._search_until, self._has_searched = 0.0, False
        self._next_save, self._written = monotonic(), self._writer.submit(lambda: None)

    def answers(self, requests: list[tuple[Any, ...]]) -> list[tuple[int, Any]]:
        """Do what is asked for, one after another."""
        self._search_until, self._has_searched = monotonic() + SEARCH_WITHIN, False
        return [self._answer(*one) for one in requests]

    def _answer(self, number: int, verb: str, *arguments: Any) -> tuple[int, Any]:
        """Do one thing, a public method; what cannot be done is the answer, too."""
        try:
            return number, getattr(self, verb)(*arguments)
        except RefusedError as refused:
            return number, refused
        except Exception:
            log.exception("a client's message was not worked on")
            return number, RefusedError(500, "the service made a mistake with this message; please report it")

    def open(self, client: str, name: str, is_binary: bool, anew: bool) -> dict[str, Any] | None:
        """Begin to follow a client, from where it was if it was here; None while its maps are made ready.

        Gives what its welcome says of that.
        """
        if anew:
            self._forget(client)
        body = self._bodies.get(client)
        is_resumed = body is not None
        if body is None:
            if len(self._bodies) >= self._config.max_clients:
                self._drop(everyone=True)
            try:
                state = checkpoints.path_of(self._config.states, client).read_bytes()
            except FileNotFoundError:
                state = None
            try:
                body = None if state is None else Body.resumed(self._known, self._config.localizer, state)
            except NotReadyError:
                return None
            is_resumed = body is not None
            body = self._bodies[client] = body or Body(self._known, self._config.localizer)
        body.name, body.is_binary, body.left_at = name or body.name, is_binary, None
        return {"resumed": is_resumed, "n": body.n, "t": body.t}

    def take(self, client: str, message: str | bytes) -> str | bytes:
        """Give the answer to a message."""
        body = self._bodies[client]
        body.move_on(self._known)
        return body.take(message, self._config.max_samples, may_search=self._may_search)

    def _may_search(self) -> bool:
        """Whether a batch may begin a search: the first one always, so that bodies are found on a busy machine."""
        is_first, self._has_searched = not self._has_searched, True
        return is_first or monotonic() < self._search_until

    def leave(self, client: str) -> None:
        """Hear that a client is gone; it may come back."""
        body = self._bodies.get(client)
        if body is not None and body.n == 0:
            del self._bodies[client]
        elif body is not None:
            body.left_at = monotonic()

    def watch(self, with_trail: bool) -> list[dict[str, Any]]:
        """Tell what is drawn of each body."""
        return [body.picture(client, with_trail=with_trail) for client, body in self._bodies.items()]

    def renew(self) -> None:
        """Begin to load the maps again; those in use answer until that is done."""
        self._loading = self._loader.submit(load_places, self._place)

    def renewed(self) -> bool | str:
        """Say whether that is done, or what is wrong with the maps."""
        if self._loading is None or not self._loading.done():
            return False
        loading, self._loading = self._loading, None
        try:
            self._known = loading.result()
            self._known.loader = self._loader
        except (MagmatchError, OSError) as error:
            return str(error)
        return True

    def keep_up(self) -> None:
        """Write a state where one is due, each in its turn so that nobody waits for all; drop who left long ago."""
        now, every = monotonic(), self._config.checkpoint_every
        if not self._bodies or now < self._next_save or not self._written.done():
            return
        # A disk that is slow is waited for, not caught up with.
        self._next_save = max(self._next_save, now - every) + every / len(self._bodies)
        client = next(iter(self._bodies))
        self._bodies.move_to_end(client)
        self._save(client)
        self._drop()

    def close(self) -> None:
        """Write everything."""
        self._save_all()
        self._writer.shutdown()
        self._loader.shutdown(cancel_futures=True)

    def _save_all(self) -> None:
        for client in self._bodies:
            self._save(client)

    def _save(self, client: str) -> None:
        body = self._bodies[client]
        if not body.is_kept:
            self._written = self._writer.submit(_save, checkpoints.path_of(self._config.states, client), body.state())
            body.is_kept = True

    def _drop(self, *, everyone: bool = False) -> None:
        """Let go of bodies whose clients are gone, once they are on the disk."""
        patience = 0.0 if everyone else LINGER
        gone = [c for c, b in self._bodies.items() if b.left_at is not None and monotonic() >= b.left_at + patience]
        if gone:
            self._save_all()
            self._writer.submit(int).result()
        for client in gone:
            del self._bodies[client]

    def _forget(self, client: str) -> None:
        self._bodies.pop(client, None)
        # It goes after whatever is still to be written of it.
        self._writer.submit(checkpoints.path_of(self._config.states, client).unlink, missing_ok=True).result()


def _save(path: Path, state: bytes) -> None:
    try:
        write_whole(path, state)
    except (OSError, MagmatchError) as error:
        log.warning("the state of a client was not kept: %s", error)
