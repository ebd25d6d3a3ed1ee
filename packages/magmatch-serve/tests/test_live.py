# SPDX-License-Identifier: BSD-3-Clause
"""Samples in, poses out: of whom, in which order, and across reconnects and restarts."""

import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from websockets.exceptions import ConnectionClosed

from magmatch.localization.kept_state import KINDS
from magmatch.localization.known_places import KnownPlaces, open_place
from magmatch.localization.localizer import Localizer
from magmatch.store import load
from magmatch_serve.bodies.body import SCHEMA
from magmatch_serve.messages import read_pose
from magmatch_serve.replay import replay
from serving import client, packed, samples, serving, wait_until


@pytest.fixture(scope="module")
def known(hall):
    return KnownPlaces(open_place(hall.map))


def followed(socket, rows, form=json.dumps):
    """Answers to samples, one each."""
    said = []
    for row in rows:
        socket.send(form(row))
        said.append(read_pose(socket.recv(timeout=30)))
    return said


@pytest.mark.parametrize(("form", "off"), [("json", 1e-6), ("binary", 2e-3)])
def test_answers_are_those_of_a_localizer(door, hall, known, form, off):
    log, _ = hall.walk(2)
    with client(door, answers=form) as one:
        # Positions of binary samples are single precision.
        said = followed(one.socket, samples(log), form=packed if form == "binary" else json.dumps)
    localizer = Localizer(known)
    field = log.orientations.inv().apply(log.field)
    for n, answer in enumerate(said):
        T = RigidTransform.from_components(log.positions[n], log.orientations[n])
        localizer.update(float(log.times[n]), T, field[n])
        now = localizer.estimate()
        assert (answer["status"], answer["n"], answer["t"]) == (now.status.value, n + 1, log.times[n])
        if now.T_map_body is not None:
            np.testing.assert_allclose(answer["T_map_body"], now.matrix, atol=off)
            np.testing.assert_allclose(np.diag(answer["covariance"]), np.diag(now.covariance), rtol=0.05)
            if form == "json":
                np.testing.assert_allclose(answer["covariance"], now.covariance, rtol=1e-4, atol=1e-10)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (691234.5, 5334567.25, 512.0)])
def test_a_replayed_log_is_found_where_it_was_walked(door, hall, origin):
    log, truth = hall.walk(3)
    found = replay(replace(log, positions=log.positions + origin), door.url, speed=1000.0)
    rows = np.searchsorted(log.times, found.times)
    off = np.linalg.norm(found.poses.translation - truth[rows], axis=1)
    assert found.n_answers == len(log)
    assert len(rows) > 0.6 * len(log)
    assert np.median(off) < 0.15


def test_several_samples_in_a_message_have_one_answer(door, hall):
    rows = list(samples(hall.walk(4, laps=0.3)[0]))
    with client(door) as one:
        said = followed(one.socket, rows)[-1]
    with client(door) as one:
        for k in range(0, len(rows), 20):
            one.socket.send(json.dumps({"samples": rows[k : k + 20]}))
            last = json.loads(one.socket.recv(timeout=30))
    assert (last["n"], last["T_map_body"]) == (said["n"], said["T_map_body"])


def test_a_client_that_comes_back_goes_on_with_the_same_bits(door, hall):
    rows = list(samples(hall.walk(5)[0]))
    with client(door) as one:
        whole = followed(one.socket, rows)
    with client(door) as one:
        key = one.welcome["key"]
        followed(one.socket, rows[:40])
    with client(door, key) as one:
        assert one.welcome["resumed"]
        assert (one.welcome["n"], one.welcome["t"]) == (40, rows[39]["t"])
        assert followed(one.socket, rows[40:]) == whole[40:]


def test_another_key_opens_nothing_and_an_id_that_all_may_see_is_none(door, hall):
    with client(door) as one:
        followed(one.socket, list(samples(hall.walk(5)[0]))[:5])
        key = one.welcome["key"]
        assert one.welcome["client"] not in key
    for said in ({"key": ("B" if key[0] != "B" else "C") + key[1:]}, {}):
        with client(door, **said) as other:
            assert (other.welcome["resumed"], other.welcome["n"]) == (False, 0)
    with pytest.raises(ConnectionClosed) as closed, client(door, one.welcome["client"]):
        pass
    assert closed.value.rcvd.code == 4422


def test_a_client_may_begin_anew(door, hall):
    rows = list(samples(hall.walk(5)[0]))
    with client(door) as one:
        key = one.welcome["key"]
        followed(one.socket, rows[:40])
    with client(door, key, anew=True) as one:
        assert (one.welcome["resumed"], one.welcome["n"]) == (False, 0)
        assert followed(one.socket, rows[:1])[0]["n"] == 1


def test_the_second_connection_of_a_key_takes_the_place_of_the_first(door, hall):
    rows = list(samples(hall.walk(5)[0]))
    with client(door) as first:
        followed(first.socket, rows[:10])
        with client(door, first.welcome["key"]) as second:
            assert second.welcome["n"] == 10
            with pytest.raises(ConnectionClosed) as closed:
                first.socket.recv(timeout=10)
            assert followed(second.socket, rows[10:12])[-1]["n"] == 12
    assert closed.value.rcvd.code == 4409


def test_a_bad_sample_is_told_and_forgotten(door, hall):
    rows = list(samples(hall.walk(5)[0]))
    with client(door) as one:
        good = followed(one.socket, rows[:30])
    with client(door) as one:
        said = []
        for k, row in enumerate(rows[:30]):
            if k % 10 == 5:
                one.socket.send(json.dumps(row | {"field": [30.0, 0.0, 40.0]}))
                assert "multiply by 1e-6" in json.loads(one.socket.recv(timeout=30))["message"]
            said += followed(one.socket, [row])
    assert said == good


@pytest.mark.slow
def test_states_outlive_kills_of_trackers_and_of_the_service(hall, tmp_path):
    (tmp_path / "often.yaml").write_text("checkpoint_every: 0.5\ntrackers: 1\n")
    rows = list(samples(hall.walk(6, laps=0.6)[0]))
    options = ("--config", tmp_path / "often.yaml", "--states", tmp_path / "states")
    with serving(hall.map, *options) as service:
        with client(service) as one:
            key = one.welcome["key"]
            followed(one.socket, rows[:50])
            kept = wait_until(lambda: list((tmp_path / "states").glob("*.state")))
            wait_until(lambda: load(kept[0], SCHEMA, KINDS)["n"] == 50)
            for tracker in trackers_of(service):
                os.kill(tracker, signal.SIGKILL)
            with pytest.raises(ConnectionClosed) as closed:
                one.socket.recv(timeout=30)
            assert closed.value.rcvd.code == 4503
        wait_until(lambda: service.ask("/health")[0] == 200)
        with client(service, key) as one:
            assert (one.welcome["resumed"], one.welcome["n"]) == (True, 50)
            followed(one.socket, rows[50:80])
            wait_until(lambda: load(kept[0], SCHEMA, KINDS)["n"] == 80)
        children = trackers_of(service)
        service.end(signal.SIGKILL)
        wait_until(lambda: not any(map(is_alive, children)))
    with serving(hall.map, *options) as service, client(service, key) as one:
        assert (one.welcome["resumed"], one.welcome["n"]) == (True, 80)
        said = followed(one.socket, rows[80:])
    assert said[-1]["status"] == "localized"


@pytest.mark.slow
def test_a_stop_of_all_its_processes_at_once_loses_nothing(hall, tmp_path):
    # As service managers stop them. No state is due before that.
    (tmp_path / "late.yaml").write_text("checkpoint_every: 10000\ntrackers: 1\n")
    options = ("--config", tmp_path / "late.yaml", "--states", tmp_path / "states")
    rows = list(samples(hall.walk(6, laps=0.6)[0]))[:60]
    with serving(hall.map, *options) as service, client(service) as one:
        key = one.welcome["key"]
        followed(one.socket, rows)
        for tracker in trackers_of(service):
            os.kill(tracker, signal.SIGTERM)
        assert "Traceback" not in service.end()
    with serving(hall.map, *options) as service, client(service, key) as one:
        assert (one.welcome["resumed"], one.welcome["n"]) == (True, 60)


def trackers_of(service):
    """Processes that a service started."""
    pid = service.process.pid
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in children if is_alive(child)]


def is_alive(pid):
    try:
        return "spawn_main" in Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return False
