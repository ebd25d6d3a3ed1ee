# SPDX-License-Identifier: BSD-3-Clause
"""Limits, keys, kept states and listings of maps, each alone."""

import asyncio
import ctypes
import os
import pickle
import shutil
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from magmatch.errors import ConfigurationError
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.field.saved_map import MapFile
from magmatch.registration.index.map_index import index_path, open_index, prepare_index
from magmatch_serve.allowance import Allowance, Allowances
from magmatch_serve.bodies import checkpoints
from magmatch_serve.bodies.tracker import Tracker, load_places
from magmatch_serve.bodies.trackers import TrackerHandle
from magmatch_serve.catalogue import Catalogue, look_at
from magmatch_serve.config import ServeConfig
from magmatch_serve.keys import id_of, is_key, new_key
from magmatch_serve.logs.remarks import in_query_words
from magmatch_serve.logs.work import WhereOfLog, picture_of, read_question, work_on_log
from magmatch_serve.logs.workers import LogWorkers
from magmatch_serve.messages import write_sample
from magmatch_serve.openapi import openapi
from magmatch_serve.refusals import RefusedError
from magmatch_serve.serve import prepare_once


class FakeClock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def test_an_allowance_gives_its_rate_and_no_more_and_waiting_as_long_as_it_says_is_enough():
    clock = FakeClock()
    one, taken = Allowance(10.0, 20.0, clock), 0
    for _ in range(1000):
        clock.now += 0.01
        if one.take() > 0:
            one.give_back()
        else:
            taken += 1
    assert 119 <= taken <= 120  # sums of hundredths are rounded
    wait = [one.take(4) for _ in range(3)][-1]
    clock.now += wait
    assert one.take(0) == pytest.approx(0, abs=1e-9)


def test_one_address_s_requests_cost_another_none_and_few_are_remembered():
    clock = FakeClock()
    all_of_them = Allowances(60.0, most_known=3, clock=clock)
    assert [all_of_them.take("a") > 0 for _ in range(12)] == [False] * 10 + [True] * 2
    assert all_of_them.take("b") == 0
    for name in "cde":
        all_of_them.take(name)
    assert len(all_of_them._known) == 3


def test_keys_are_not_their_ids():
    keys = {new_key() for _ in range(50)}
    assert len(keys) == len({id_of(key) for key in keys}) == 50
    assert all(is_key(key) and not is_key(id_of(key)) for key in keys)
    assert not any(map(is_key, ("", "a" * 42, "a" * 44, "../" + "a" * 40, "a" * 42 + "\n")))


def test_states_that_cannot_be_kept_say_where_else(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(ConfigurationError, match=r"cannot be kept there .*--states OTHER-FOLDER"),
        checkpoints.held(tmp_path / "file" / "states"),
    ):
        pass


def test_sweeping_leaves_what_is_not_ours(tmp_path):
    folder = tmp_path / "states"
    with checkpoints.held(folder):
        state = checkpoints.path_of(folder, id_of(new_key()))
        for path in (state, folder / "other.txt"):
            path.touch()
            os.utime(path, (time.time() - 100,) * 2)
        checkpoints.sweep(folder, 200.0)
        assert state.exists()
        checkpoints.sweep(folder, 50.0)
        assert sorted(path.name for path in folder.iterdir()) == ["lock", "other.txt"]
        assert (folder.stat().st_mode & 0o777) == 0o700


def test_states_are_written_in_turn_each_as_often_as_it_shall_be(hall, tmp_path, monkeypatch):
    clock, clients = FakeClock(), [f"{k:024x}" for k in range(4)]
    monkeypatch.setattr("magmatch_serve.bodies.tracker.monotonic", clock)
    (tmp_path / "states").mkdir()
    config = ServeConfig(states=tmp_path / "states", checkpoint_every=4.0)
    tracker, written = Tracker(load_places(hall.map), hall.map, config), []
    for client in clients:
        tracker.open(client, "", False, False)
    for n in range(80):
        clock.now += 0.25
        for client in clients:
            tracker.take(client, write_sample(clock.now, np.zeros(3), np.array([0.0, 0, 0, 1]), np.full(3, 2e-5)))
        tracker.keep_up()
        tracker._written.result()
        written += [(n, client) for client in clients if tracker._bodies[client].is_kept]
    tracker.close()
    turns = {client: [n for n, other in written if other == client] for client in clients}
    assert all(np.diff(of).max() * 0.25 <= 4.0 and of[0] * 0.25 <= 4.0 for of in turns.values())
    assert len({n for n, _ in written}) == len(written)


@pytest.mark.parametrize("host", ["0.0.0.0", "maps.example.org"])
def test_other_machines_need_a_token(tmp_path, host):
    with pytest.raises(ConfigurationError, match="token"):
        ServeConfig(host=host, states=tmp_path)
    ServeConfig(host=host, states=tmp_path, token="a-token-of-enough-letters")


@pytest.mark.parametrize("token", ["short", "a b c d e f g h i j k l", "x" * 20 + "\n", "ü" * 20])
def test_a_token_that_anyone_guesses_or_no_header_holds_is_refused(tmp_path, token):
    with pytest.raises(ConfigurationError, match="token"):
        ServeConfig(states=tmp_path, token=token)


@pytest.mark.parametrize("origin", ["maps.example.org", "https://a.org/", "*"])
def test_what_is_no_origin_is_refused(tmp_path, origin):
    with pytest.raises(ConfigurationError, match="origin"):
        ServeConfig(states=tmp_path, origins=(origin,))


def test_a_map_is_new_once_nobody_writes_it(hall, tmp_path):
    folder = tmp_path / "maps"
    folder.mkdir()
    (folder / "one.map").write_bytes(hall.map.read_bytes())
    listing = Catalogue(folder, look_at(folder))
    assert listing.newer() is None
    (folder / "two.map").write_bytes(hall.map.read_bytes()[:5000])
    assert listing.newer() is None
    (folder / "two.map").write_bytes(hall.map.read_bytes())
    assert listing.newer() is None
    found = listing.newer()
    assert [name for name, *_ in found.maps] == ["one.map", "two.map"]
    listing.settle(found, ["damaged"])
    assert (listing.served.names, listing.fault, listing.newer()) == (["one.map"], "damaged", None)
    (folder / "two.map").unlink()
    (folder / "three.map").write_bytes(hall.map.read_bytes())
    assert listing.newer() is None
    listing.settle(listing.newer(), [])
    assert (listing.served.names, listing.fault) == (["one.map", "three.map"], None)


@pytest.mark.parametrize(("is_folder_left", "words"), [(True, "holds no map any more"), (False, "is gone")])
def test_a_folder_that_is_emptied_or_gone_is_told(hall, tmp_path, is_folder_left, words):
    folder = tmp_path / "maps"
    folder.mkdir()
    shutil.copy(hall.map, folder / "one.map")
    listing = Catalogue(folder, look_at(folder))
    (folder / "one.map").unlink()
    if not is_folder_left:
        folder.rmdir()
    assert [listing.newer() for _ in range(3)] == [None] * 3
    assert listing.document()["fault"] == f"maps: {words}"
    assert listing.served.names == ["one.map"]


def test_a_process_that_follows_clients_is_started_until_it_can_be(tmp_path, monkeypatch):
    tries = []

    async def revived():
        handle = TrackerHandle(tmp_path, ServeConfig(states=tmp_path))

        async def start():
            tries.append(1)
            if len(tries) < 12:
                raise OSError

        monkeypatch.setattr(handle, "start", start)
        await asyncio.wait_for(handle._revive(), 30)

    monkeypatch.setattr("magmatch_serve.bodies.trackers.PAUSES", (0.0, 0.0))
    asyncio.run(revived())
    assert len(tries) == 12


def test_a_token_that_is_refused_is_not_said(tmp_path):
    with pytest.raises(ConfigurationError) as refused:
        ServeConfig(states=tmp_path, token="a-token with a blank in it")
    assert "blank" not in str(refused.value)


def test_a_map_is_prepared_once_for_all_processes_that_the_service_starts(hall, tmp_path):
    place = tmp_path / "small.map"
    numbers = FieldConfig(prior="spline", lengthscale=0.8, signal_sd=1e-5, noise_sd=3e-7, spacing=0.4)
    build_map(hall.walk(2)[0].subset(np.arange(60)), numbers).save(place)
    prepare_once(place)
    whole, made_at = index_path(place).read_bytes(), index_path(place).stat().st_mtime_ns
    assert open_index(MapFile.of(place)).is_whole
    prepare_once(place)
    assert index_path(place).stat().st_mtime_ns == made_at
    # What the registration of no walk leaves is not all that is needed.
    index_path(place).unlink()
    prepare_index(FieldMap.load(place))
    assert not open_index(MapFile.of(place)).is_whole
    prepare_once(index_path(place))
    assert index_path(place).read_bytes() == whole


def test_maps_that_vanished_are_not_a_client_s_fault_and_break_no_worker(hall, tmp_path):
    shutil.copy(hall.map, tmp_path / "hall.map")
    served = look_at(tmp_path)
    (tmp_path / "hall.map").unlink()
    with pytest.raises(RefusedError) as refused:
        picture_of(tmp_path, served, "hall.map")
    # What does not come whole out of a process ends all work on logs.
    told = pickle.loads(pickle.dumps(refused.value))
    assert told.status == 503
    assert str(tmp_path) not in told.message


def test_what_is_short_waits_for_no_log(tmp_path):
    async def seven():
        workers = LogWorkers(ServeConfig(states=tmp_path, log_workers=1))
        logs = [asyncio.ensure_future(workers.run(time.sleep, 3600)) for _ in range(3)]
        try:
            return await workers.run_short(int, "7")
        finally:
            for log in logs:
                log.cancel()
            await asyncio.gather(*logs, return_exceptions=True)
            workers.close()

    assert asyncio.run(seven()) == 7


@pytest.mark.parametrize("is_folder", [False, True])
def test_a_registration_is_told_of_the_vertical(hall, tmp_path, is_folder):
    place = hall.map
    if is_folder:
        place = tmp_path / "maps"
        place.mkdir()
        for path in (hall.map, index_path(hall.map)):
            shutil.copy(path, place)
    hall.walk(2)[0].save(tmp_path / "log.csv")
    question = read_question("register", [("planar", "1")])
    found = work_on_log(place, look_at(place), tmp_path / "log.csv", question, ServeConfig(states=tmp_path))
    assert found["config"]["prior"]["is_planar"]


def test_what_is_odd_about_a_log_is_told_to_its_sender_and_nobody_else(hall, tmp_path, capfd):
    log = hall.walk(2)[0]
    replace(log, field=np.tile([2e-5, 0.0, -4e-5], (len(log), 1))).save(tmp_path / "log")
    for verb in ("localize", "register"):
        question = read_question(verb, [])
        found = work_on_log(hall.map, look_at(hall.map), tmp_path / "log", question, ServeConfig(states=tmp_path))
        assert found["warnings"][0] == (
            "log: the field is constant (varies less than 1 nT): nothing tells places apart"
        )
        assert str(tmp_path) not in str(found["warnings"])
    assert found["reason"].startswith("target: the field is constant")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(("verb", "schema"), [("localize", "Localization"), ("register", "Registration")])
def test_answers_are_as_the_openapi_document_says(hall, tmp_path, verb, schema):
    hall.walk(2)[0].save(tmp_path / "log")
    config = ServeConfig(states=tmp_path)
    found = work_on_log(hall.map, look_at(hall.map), tmp_path / "log", read_question(verb, []), config)
    assert set(found) - set(openapi()["components"]["schemas"][schema]["properties"]) == {"schema"}


@pytest.mark.parametrize("home", ["/", None])
def test_a_service_whose_user_has_no_home_still_says_why(hall, tmp_path, monkeypatch, home):
    monkeypatch.delenv("HOME") if home is None else monkeypatch.setenv("HOME", home)
    (tmp_path / "log").write_text("t,x/y\n1,2\n")
    refused = work_on_log(hall.map, look_at(hall.map), tmp_path / "log", WhereOfLog(), ServeConfig(states=tmp_path))
    assert "x/y" in refused.message


ADVICE = {
    "use --field-frame sensor (in Python field_frame)": "use field_frame=sensor",
    "read as T; if the file is in uT, use --field-unit uT": "read as T; if the file is in uT, use field_unit=uT",
    "use --target-field-frame survey": "use field_frame=survey",
    "use --gravity-aligned (--planar if heights agree)": "use gravity_aligned=true (planar=true if heights agree)",
    "wrong length unit (--length-unit), or --other": "wrong length unit (length_unit), or --other",
}


@pytest.mark.parametrize("words", ADVICE)
def test_advice_is_in_words_of_the_query(words):
    said = in_query_words(words, {"gravity_aligned", "planar"}, {"field_frame", "field_unit", "length_unit"})
    assert said == ADVICE[words]


# Reads a log twice in a process of its own: what other tests left in a heap decides what that heap can give back.
READ_TWICE = """
import os, sys
from pathlib import Path
from magmatch_serve.catalogue import look_at
from magmatch_serve.config import ServeConfig
from magmatch_serve.logs.work import WhereOfLog, work_on_log

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

map_path, log = Path(sys.argv[1]), Path(sys.argv[2])
def status():
    return work_on_log(map_path, look_at(map_path), log, WhereOfLog(), ServeConfig(states=log.parent)).status

# What a first log imports stays.
first = status()
pieces = [b"x" * 50_000 for _ in range(4000)]
full = resident()
# Some stay: the heap cannot shrink from its end.
pieces = pieces[::64]
print(first, status(), full - resident() > 150e6)
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="another allocator")
def test_what_a_log_needed_is_given_back_after_it(hall, tmp_path):
    (tmp_path / "log").write_text("t,x\n1,2\n")
    command = [sys.executable, "-c", READ_TWICE, str(hall.map), str(tmp_path / "log")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert printed.split() == ["422", "422", "True"]
