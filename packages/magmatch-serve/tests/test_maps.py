# SPDX-License-Identifier: BSD-3-Clause
"""Maps that are added or replaced while they are served; whole logs; what Foxglove is told."""

import json
import os
import re
import shutil
import signal
import threading
from contextlib import contextmanager, suppress
from http.client import HTTPException
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from websockets.sync.client import connect

from drifting import Place, drifting_walk
from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch.field.map import FieldMap
from magmatch.localization.localize import localize
from magmatch.registration.index.map_index import index_path
from magmatch_serve.bodies import checkpoints
from serving import client, samples, serving, wait_until


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A map of another hall."""
    path = tmp_path_factory.mktemp("other") / "other.map"
    _, truth = drifting_walk(Place(2), 7, laps=2.0)
    build_map(Survey(truth, Place(2).field(truth), name="other"), SPLINE).save(path)
    return path


@pytest.fixture
def one_tracker(tmp_path):
    """Settings under which one process follows clients."""
    path = tmp_path / "one.yaml"
    path.write_text("trackers: 1\n")
    return path


def copy_to(folder, path):
    """Copy a map with its index."""
    for each in (path, index_path(path)):
        shutil.copy(each, folder)


def last_answer(service, log, n=None, key=None):
    with client(service, key) as one:
        for row in list(samples(log))[:n]:
            one.socket.send(json.dumps(row))
            said = json.loads(one.socket.recv(timeout=60))
    return said


@pytest.mark.slow
def test_a_folder_is_served_as_one_and_grows_while_it_is(hall, other, tmp_path):
    folder = tmp_path / "maps"
    folder.mkdir()
    copy_to(folder, hall.map)
    (tmp_path / "limits.yaml").write_text("trackers: 1\nlook_every: 0.3\n")
    walk = drifting_walk(Place(2), 3, laps=0.4, start=1.0, turn=0.5)[0]
    with serving(folder, "--config", tmp_path / "limits.yaml") as service:
        assert last_answer(service, hall.walk(2)[0])["map"] == "hall.map"
        assert last_answer(service, walk)["map"] is None
        before = json.loads(service.ask("/maps")[2])
        # Half of a map is not served; what was there still is.
        whole = other.read_bytes()
        (folder / "other.map").write_bytes(whole[:-2000])
        wait_until(lambda: json.loads(service.ask("/maps")[2])["fault"])
        assert b"magmatch_map_fault 1.0" in service.ask("/metrics")[2]
        told = json.loads(service.ask("/maps")[2])
        assert (told["version"], str(tmp_path) in json.dumps(told)) == (before["version"], False)
        # Nor do logs wait for it.
        assert service.ask("/localize", survey_csv(hall.walk(2)[0], tmp_path))[0] == 200
        assert last_answer(service, hall.walk(2)[0])["map"] == "hall.map"
        (folder / "new").write_bytes(whole)
        (folder / "new").replace(folder / "other.map")
        now = wait_until(lambda: (m := json.loads(service.ask("/maps")[2]))["version"] != before["version"] and m)
        assert ([m["name"] for m in now["maps"]], now["fault"]) == (["hall.map", "other.map"], None)
        assert last_answer(service, walk)["map"] == "other.map"
        status, _, said = service.ask("/maps/other.map")
        assert (status, json.loads(said)["name"]) == (200, "other.map")
        status, _, said = service.ask("/localize", survey_csv(walk, tmp_path))
        assert (status, json.loads(said)["map"]) == (200, "other.map")


def survey_csv(log, tmp_path):
    log.save(tmp_path / "log.csv")
    return (tmp_path / "log.csv").read_bytes()


def test_a_whole_log_is_localized_as_it_is_here(door, hall, tmp_path):
    log = hall.walk(2)[0]
    status, _, said = door.ask("/localize", survey_csv(log, tmp_path))
    document = json.loads(said)
    track = localize(FieldMap.load(hall.map), log)
    assert (status, document["status"]) == (200, "localized")
    rows = np.array(document["trajectory"])
    np.testing.assert_allclose(rows[:, 1:4], track.poses.translation, atol=1e-6)
    np.testing.assert_array_equal(rows[:, 0], log.times[track.is_stated])
    assert str(tmp_path.parent) not in said.decode()


def test_a_whole_survey_is_registered(door, hall, tmp_path):
    log, truth = hall.walk(2)
    status, _, said = door.ask("/register?seed=3&gravity_aligned=true", survey_csv(log, tmp_path))
    document = json.loads(said)
    assert (status, document["schema"], document["seed"]) == (200, "magmatch.registration/1", 3)
    T = np.array(document["T_base_target"])
    assert np.linalg.norm(log.positions[0] @ T[:3, :3].T + T[:3, 3] - truth[0]) < 1.0


def test_what_is_counted_is_told_to_prometheus(door, hall):
    last_answer(door, hall.walk(2)[0], 20)
    status, headers, said = door.ask("/metrics")
    counts = dict(line.rsplit(" ", 1) for line in said.decode().splitlines() if not line.startswith("#"))
    assert (status, headers["content-type"].split(";")[0]) == (200, "text/plain")
    assert float(counts["magmatch_messages_total"]) >= 20
    assert float(counts['magmatch_answer_seconds_bucket{le="+Inf"}']) == float(counts["magmatch_messages_total"])


def test_the_openapi_document_names_every_path(door):
    document = json.loads(door.ask("/openapi.json")[2])
    assert document["openapi"].startswith("3.1")
    for path, methods in document["paths"].items():
        for method in methods:
            if path in {"/live", "/watch"}:
                continue
            body = b"x" if method == "post" else None
            status, _, _ = door.ask(path.replace("{name}", "hall.map"), body, method=method.upper())
            assert status in {200, 422}
    referred = set(re.findall(r"#/components/schemas/(\w+)", json.dumps(document)))
    assert referred <= set(document["components"]["schemas"])


TOPICS = {"/tf", "/bodies", "/maps"}


def test_foxglove_sees_hypotheses_and_a_map_whose_unknown_parts_are_nan():
    messages = pytest.importorskip("foxglove.messages")
    from magmatch_serve.foxglove_feed import FoxgloveFeed

    feed, seen = FoxgloveFeed(0), []
    feed._scene = feed._maps = SimpleNamespace(log=seen.append)
    feed.show([{"client": "c", "hypotheses": [["hall", 1.0, 2.0, 3.0, 0.25], ["hall", 5.0, 2.0, 3.0, 0.01]]}])
    picture = {"shape": [2, 3], "x": [0.0, 4.0], "y": [1.0, 2.0], "height": 1.5}
    feed.show_map("hall", picture | {"field_ut": [[1.0, None, 3.0], [4.0, 5.0, 6.0]]})
    feed.stop()
    assert [type(one) for one in seen] == [messages.SceneUpdate, messages.Grid]
    words = repr(seen[0])
    assert words.count("SpherePrimitive") == 2
    assert "size: Some(Vector3 { x: 0.5," in words
    # The corner of the first cell lies half a cell beside its middle.
    expected = np.array([1, np.nan, 3, 4, 5, 6], "<f4").tobytes()
    assert expected in seen[1].encode()
    assert "Vector3 { x: -1.0, y: 0.5, z: 1.5 }" in repr(seen[1])


def test_foxglove_tells_clients_of_one_name_apart():
    pytest.importorskip("foxglove")
    from magmatch_serve.foxglove_feed import FoxgloveFeed

    feed, seen = FoxgloveFeed(0), []
    feed._frames, feed._scene = SimpleNamespace(log=seen.append), SimpleNamespace(log=lambda _: None)
    about = {
        "map": "hall",
        "status": "localized",
        "T_map_body": np.eye(4).tolist(),
        "covariance_xy": [[1, 0], [0, 1]],
    }
    feed.show([about | {"client": client, "name": "replay"} for client in ("0a", "1b")])
    feed.stop()
    assert [f"replay {client}" in repr(seen[0]) for client in ("0a", "1b")] == [True, True]


@pytest.mark.slow
def test_foxglove_is_told_of_bodies(hall, one_tracker, tmp_path):
    pytest.importorskip("foxglove")
    import socket

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = ("--states", tmp_path / "states", "--config", one_tracker)
    with serving(hall.map, "--foxglove", port, *options) as service:
        said = last_answer(service, hall.walk(2)[0])
        url = f"ws://127.0.0.1:{port}"
        with connect(url, proxy=None, subprotocols=["foxglove.sdk.v1"], compression=None) as viewer:
            topics = {}
            while TOPICS - set(topics):
                message = viewer.recv(timeout=30)
                if isinstance(message, str) and (found := json.loads(message))["op"] == "advertise":
                    topics |= {c["topic"]: c["id"] for c in found["channels"]}
            asked = [{"id": k, "channelId": topics[name]} for k, name in enumerate(sorted(TOPICS))]
            viewer.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
            seen = b""
            while not (said["map"].encode() in seen and b"field_ut" in seen):
                message = viewer.recv(timeout=30)
                seen += message if isinstance(message, bytes) else b""


@pytest.mark.slow
def test_a_folder_that_is_away_or_emptied_is_served_on_once_there_is_a_map(hall, other, tmp_path):
    folder, gone = tmp_path / "maps", tmp_path / "gone"
    folder.mkdir()
    copy_to(folder, hall.map)
    (tmp_path / "limits.yaml").write_text("trackers: 1\nlook_every: 0.3\n")
    body = survey_csv(hall.walk(2)[0], tmp_path)
    with serving(folder, "--config", tmp_path / "limits.yaml") as service:
        assert service.ask("/localize", body)[0] == 200
        # The clients' states lie in the folder, too.
        folder.rename(gone)
        wait_until(lambda: b"is gone" in service.ask("/maps")[2])
        assert service.ask("/localize", body)[0] == 503
        gone.rename(folder)
        wait_until(lambda: json.loads(service.ask("/maps")[2])["fault"] is None)
        (folder / "hall.map").unlink()
        wait_until(lambda: json.loads(service.ask("/maps")[2])["fault"] == "maps: holds no map any more")
        assert service.ask("/localize", body)[0] == 200
        shutil.copy(other, folder / "new")
        (folder / "new").replace(folder / "other.map")
        wait_until(lambda: [m["name"] for m in json.loads(service.ask("/maps")[2])["maps"]] == ["other.map"])
        assert last_answer(service, hall.walk(2)[0])["map"] is None
        assert service.words().count("holds no map any more") == 1
        assert "Traceback" not in service.words()


@pytest.mark.slow
def test_a_log_is_answered_though_the_process_that_works_on_logs_is_killed(hall, one_tracker, tmp_path):
    body, states = survey_csv(hall.walk(2)[0], tmp_path), tmp_path / "states"
    with serving(hall.map, "--states", states, "--config", one_tracker) as service:
        followers = children_of(service.process.pid)
        assert service.ask("/localize", body)[0] == 200
        send_all(signal.SIGKILL, workers_of(service, followers))
        assert service.ask("/localize", body)[0] == 200
        with sent_to_stopped_workers(service, followers, body, states) as (stopped, answers):
            send_all(signal.SIGKILL, stopped)
        assert answers[0][0] == 200
        assert not list(states.glob("log-*"))
        # A service that is killed leaves a log, which the next one removes.
        with sent_to_stopped_workers(service, followers, body, states) as (stopped, _):
            service.end(signal.SIGKILL)
            send_all(signal.SIGKILL, stopped)
    assert list(states.glob("log-*"))
    with checkpoints.held(states):  # by which a service begins, and keeps others out
        assert not list(states.glob("log-*"))


@pytest.mark.slow
def test_a_log_that_is_worked_on_when_the_service_ends_is_to_be_sent_again(hall, one_tracker, tmp_path):
    body, states = survey_csv(hall.walk(2)[0], tmp_path), tmp_path / "states"
    with serving(hall.map, "--states", states, "--config", one_tracker) as service:
        followers = children_of(service.process.pid)
        assert service.ask("/localize", body)[0] == 200
        with sent_to_stopped_workers(service, followers, body, states) as (_, answers):
            service.end()
    assert answers[0][0] == 503
    assert json.loads(answers[0][2])["status"] == 503


@contextmanager
def sent_to_stopped_workers(service, followers, body, states):
    """A log is with processes that have stopped, and is answered after the block; gives these and the answers."""
    stopped, answers = workers_of(service, followers), []

    def send():
        with suppress(OSError, HTTPException):
            answers.append(service.ask("/localize", body))

    send_all(signal.SIGSTOP, stopped)
    post = threading.Thread(target=send)
    post.start()
    wait_until(lambda: list(states.glob("log-*")))
    yield stopped, answers
    post.join()


def send_all(sign, processes):
    for pid in processes:
        os.kill(pid, sign)


def workers_of(service, followers):
    """Processes that work on logs, once there are some: all but those that follow clients."""
    return wait_until(lambda: children_of(service.process.pid) - followers)


def children_of(pid):
    return set(map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split()))
