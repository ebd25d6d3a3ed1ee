# SPDX-License-Identifier: BSD-3-Clause
"""Whoever watches is sent a first picture, however many pictures come while it is made."""

import asyncio
import json
from types import SimpleNamespace

from magmatch_serve.config import ServeConfig
from magmatch_serve.service import Service


def test_a_watcher_gets_a_first_picture_with_trails_though_others_are_drawn_while_it_is_made(hall, tmp_path):
    service = Service(hall.map, ServeConfig(states=tmp_path))

    async def watch(with_trail):
        if with_trail:
            await service._draw()
        return [{"name": "one"} | ({"trail": []} if with_trail else {})]

    async def seen():
        async with service.watched() as pictures:
            first = json.loads(pictures.get_nowait())
            for _ in range(3):  # nobody takes them
                await service._draw()
            return first, json.loads(pictures.get_nowait()), len(service._watchers)

    service.foxglove, service.trackers = None, SimpleNamespace(watch=watch)
    first, later, n_watching = asyncio.run(seen())
    assert (first["bodies"], later["bodies"]) == ([{"name": "one", "trail": []}], [{"name": "one"}])
    assert (n_watching, len(service._watchers)) == (1, 0)
