# SPDX-License-Identifier: BSD-3-Clause
"""Whoever watches is sent a first picture, however many pictures come while it is made."""

import json
from contextlib import ExitStack

from websockets.sync.client import connect

from serving import client, serving


def test_every_watcher_gets_a_first_picture_while_pictures_come_fast(hall, tmp_path):
    config = tmp_path / "fast.yaml"
    config.write_text("draw_every: 0.0005\ntrackers: 1\n")
    options = ("--config", config, "--states", tmp_path / "states")
    with serving(hall.map, *options) as service, client(service, name="one"), ExitStack() as open_ones:
        url = service.url.replace("http", "ws") + "/watch"
        for _ in range(40):
            # Who leaves does not wait for an answer behind all pictures that it never took.
            watcher = open_ones.enter_context(connect(url, proxy=None, close_timeout=0.01))
            first = json.loads(watcher.recv(timeout=20))
            assert [body["name"] for body in first["bodies"]] == ["one"]
            assert "trail" in first["bodies"][0]
