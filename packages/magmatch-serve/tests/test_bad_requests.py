# SPDX-License-Identifier: BSD-3-Clause
# ruff: noqa: PT012  # a WebSocket is closed at whichever of the steps
"""What cannot be done has its status and one sentence, and nothing of the machine is in it."""

import gzip
import io
import json
import socket
import zipfile
from contextlib import ExitStack

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from serving import client, packed, samples, serving

CSV = b"t,x,y,z,bx,by,bz,qx,qy,qz,qw\n"
ROW = b"%d,%d,0,0,2e-5,0,-4e-5,0,0,0,1\n"


def table(n, row=ROW):
    return CSV + b"".join(row % (k, k) for k in range(n))


def zipped(n_bytes):
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Magnetometer.csv", b"0" * n_bytes)
    return made.getvalue()


# Path, body, headers, method, status: one row a request.
GET, POST = "GET", "POST"
GZIP = {"Content-Encoding": "gzip"}
REQUESTS = {
    "no such path": ("/nothing", None, {}, GET, 404),
    "no such map": ("/maps/other.map", None, {}, GET, 404),
    "a map by its path": ("/maps/..%2f..%2fetc%2fpasswd", None, {}, GET, 404),
    "a map of bad UTF-8": ("/maps/%ff%fe", None, {}, GET, 404),
    "GET for POST": ("/localize", None, {}, GET, 405),
    "POST for GET": ("/maps", b"x", {}, POST, 405),
    "live without a WebSocket": ("/live", None, {}, GET, 404),
    "another page's origin": ("/maps", None, {"Origin": "https://evil.example"}, GET, 403),
    "origin of another port": ("/localize", b"x", {"Origin": "http://127.0.0.1:1"}, POST, 403),
    "another host": ("/maps", None, {"Host": "evil.example"}, GET, 421),
    "a host that is none": ("/maps", None, {"Host": "[::"}, GET, 421),
    "no body": ("/localize", b"", {}, POST, 400),
    "unknown word": ("/localize?colour=red", table(9), {}, POST, 422),
    "a word twice": ("/localize?field_unit=T&field_unit=uT", table(9), {}, POST, 422),
    "a path of ours as trajectory": ("/localize?trajectory=/etc/passwd", table(9), {}, POST, 422),
    "unknown unit": ("/localize?field_unit=pound", table(9), {}, POST, 422),
    "planar without gravity": ("/localize?planar=1&no_gravity=1", table(9), {}, POST, 422),
    "a seed below 0": ("/register?seed=-1", table(9), {}, POST, 422),
    "text": ("/localize", b"hello, world\n" * 9, {}, POST, 422),
    "an empty zip": ("/localize", b"PK\x05\x06" + bytes(18), {}, POST, 422),
    "a zip bomb": ("/localize", zipped(30_000_000), {}, POST, 413),
    "half a gzip": ("/localize", gzip.compress(table(99))[:40], {}, POST, 422),
    "one sample": ("/localize", table(1), {}, POST, 422),
    "NaN": ("/localize", table(9) + b"9,nan,0,0,2e-5,0,0,0,0,0,1\n", {}, POST, 422),
    "microtesla": ("/localize", table(99, b"%d,%d,0,0,20,0,-40,0,0,0,1\n"), {}, POST, 422),
    "no times": ("/localize", b"x,y,z,bx,by,bz\n" + b"".join(b"%d,0,%d,2e-5,0,0\n" % (k, k % 3) for k in range(99)),
                 {}, POST, 422),
    "a row too short": ("/localize", table(9) + b"9,9\n", {}, POST, 422),
    "too long a log": ("/localize", table(2000), {}, POST, 413),
    "too long a body": ("/localize", b"x" * 200_001, {}, POST, 413),
    "a body said to be too long": ("/localize", b"x", {"Content-Length": "99999999999"}, POST, 413),
    "an unknown coding": ("/localize", table(9), {"Content-Encoding": "br"}, POST, 415),
    "gzip that is none": ("/localize", table(9), GZIP, POST, 400),
    "gzip that is cut": ("/localize", gzip.compress(table(500))[:-9], GZIP, POST, 400),
    "a gzip bomb": ("/localize", gzip.compress(b"0" * 3_000_000), GZIP, POST, 413),
    "a form": ("/localize", table(9), {"Content-Type": "multipart/form-data; boundary=x"}, POST, 415),
}  # fmt: skip


def test_the_openapi_document_knows_every_status(door):
    paths = json.loads(door.ask("/openapi.json")[2])["paths"]
    told = {status for methods in paths.values() for one in methods.values() for status in one["responses"]}
    assert {str(status) for *_, status in REQUESTS.values()} <= told


def is_a_sentence_of_its_own(message):
    assert message == " ".join(message.split())
    assert 10 < len(message) < 400
    for word in ("Traceback", "/tmp", "/home", "/root", ".py", "site-packages", "magmatch-", "Error("):
        assert word not in message
    return True


@pytest.mark.parametrize("name", REQUESTS)
def test_a_bad_request_has_its_status_and_a_sentence(door, name):
    path, body, headers, method, status = REQUESTS[name]
    if headers.get("Content-Length"):
        found, said = raw(door, path, headers["Content-Length"])
    else:
        found, _, said = door.ask(path, body, headers, method)
    document = json.loads(said)
    assert (found, document["status"], document["type"]) == (status, status, "error")
    assert is_a_sentence_of_its_own(document["message"])


def raw(door, path, length):
    """What a request says whose body never comes."""
    host, port = door.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=30) as wire:
        wire.sendall(f"POST {path} HTTP/1.1\r\nHost: {host}\r\nContent-Length: {length}\r\n\r\n".encode())
        answer = wire.recv(65536)
        while b"}" not in answer:
            answer += wire.recv(65536)
    head, _, body = answer.partition(b"\r\n\r\n")
    return int(head.split()[1]), body


@pytest.mark.parametrize("words", [b"nonsense\r\n\r\n", b"GET /maps HTTP/1.1\r\nX: " + b"a" * 99_999])
def test_what_is_not_http_is_refused(door, words):
    host, port = door.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=30) as wire:
        wire.sendall(words)
        assert wire.recv(65536).split()[1] in {b"400", b"431", b"505"}
    assert "Invalid" not in door.words()


def test_a_websocket_of_another_path_is_told_so(door):
    with pytest.raises(InvalidStatus) as refused:
        connect(door.live.replace("/live", "/live/more"), proxy=None).close()
    assert refused.value.response.status_code == 404
    assert is_a_sentence_of_its_own(json.loads(refused.value.response.body)["message"])


HELLOS = {
    "not JSON": ("hello", 4400),
    "an unknown word": ('{"type": "hello", "map": "/etc/passwd"}', 4422),
    "a short key": ('{"type": "hello", "key": "a"}', 4422),
    "a long name": (json.dumps({"type": "hello", "name": "a" * 41}), 4422),
}


@pytest.mark.parametrize("name", HELLOS)
def test_a_bad_hello_closes_with_its_status(door, name):
    said, code = HELLOS[name]
    with pytest.raises(ConnectionClosed) as closed, connect(door.live, proxy=None) as wire:
        wire.send(said)
        wire.recv(timeout=30)
    assert closed.value.rcvd.code == code
    assert is_a_sentence_of_its_own(closed.value.rcvd.reason)


FRAMES = {
    "not JSON": (lambda _: "sample", 400),
    "NaN": (lambda row: json.dumps(row | {"t": float("nan")}), 422),
    "a field missing": (lambda row: json.dumps({"t": row["t"]}), 422),
    "microtesla": (lambda row: json.dumps(row | {"field": [20.0, 0.0, 40.0]}), 422),
    "no samples": (lambda _: '{"samples": []}', 422),
    "too many samples": (lambda row: json.dumps({"samples": [row] * 51}), 413),
    "half a binary sample": (lambda row: packed(row)[:-3], 400),
    "nothing": (lambda _: b"", 400),
}


@pytest.mark.parametrize("name", FRAMES)
def test_a_bad_frame_is_answered_and_the_client_goes_on(door, hall, name):
    make, status = FRAMES[name]
    rows = list(samples(hall.walk(2)[0]))[:2]
    with client(door) as one:
        one.socket.send(make(rows[0]))
        said = json.loads(one.socket.recv(timeout=30))
        assert (said["type"], said["status"]) == ("error", status)
        assert is_a_sentence_of_its_own(said["message"])
        one.socket.send(json.dumps(rows[0]))
        assert json.loads(one.socket.recv(timeout=30))["n"] == 1
        if name == "nothing":
            return
        # A clock that runs backward, at last.
        one.socket.send(json.dumps(rows[0]))
        assert "after" in json.loads(one.socket.recv(timeout=30))["message"]


def test_a_client_that_says_nothing_but_rubbish_is_sent_away(door):
    with pytest.raises(ConnectionClosed) as closed, client(door) as one:
        for _ in range(200):
            one.socket.send("rubbish")
            one.socket.recv(timeout=30)
    assert closed.value.rcvd.code == 4429


def test_a_message_that_is_too_long_is_refused(door):
    with pytest.raises(ConnectionClosed) as closed, client(door) as one:
        one.socket.send("a" * 70_000)
        one.socket.recv(timeout=30)
    assert closed.value.rcvd.code == 1009


def test_one_client_too_many_is_refused(door):
    with pytest.raises(InvalidStatus) as refused, ExitStack() as stack:
        for _ in range(9):
            stack.enter_context(client(door))
    assert refused.value.response.status_code == 503
    assert is_a_sentence_of_its_own(json.loads(refused.value.response.body)["message"])


def test_whoever_says_no_hello_is_sent_away(door):
    with pytest.raises(ConnectionClosed) as closed, connect(door.live, proxy=None) as wire:
        wire.recv(timeout=30)
    assert closed.value.rcvd.code == 4408


@pytest.mark.parametrize("headers", [{"Origin": "https://evil.example"}, {"Host": "evil.example"}])
def test_a_page_from_elsewhere_gets_no_websocket(door, headers):
    origin = headers.get("Origin")
    with pytest.raises(InvalidStatus) as refused:
        if origin:
            connect(door.live, proxy=None, origin=origin).close()
        else:
            # The address of this machine under another name, as rebinding has it.
            host, port = door.url.removeprefix("http://").split(":")
            wire = socket.create_connection((host, int(port)))
            connect(f"ws://evil.example:{port}/live", sock=wire, proxy=None).close()
    assert refused.value.response.status_code == (403 if origin else 421)


@pytest.mark.slow
def test_with_a_token_nothing_is_told_without_it(hall, tmp_path):
    token = "a-token-of-enough-letters"
    (tmp_path / "token").write_text(token + "\n")
    (tmp_path / "limits.yaml").write_text("max_requests: 60\ntrackers: 1\n")
    words = ("--token-file", tmp_path / "token", "--config", tmp_path / "limits.yaml")
    with serving(hall.map, *words, "--states", tmp_path / "states") as service:
        for path in ("/maps", "/metrics", "/maps/hall.map"):
            assert service.ask(path)[0] == 401
            assert service.ask(path, headers={"Authorization": "Bearer wrong"})[0] == 401
        assert service.ask("/maps", headers={"Authorization": f"Bearer {token}"})[0] == 200
        assert service.ask("/localize", b"x")[0] == 401
        assert service.ask("/")[0] == 200
        for given in (None, ["bearer.wrong-token"]):
            with pytest.raises(InvalidStatus) as refused:
                connect(service.live, proxy=None, subprotocols=given).close()
            assert refused.value.response.status_code == 401
        with connect(service.live, proxy=None, subprotocols=["magmatch.1", f"bearer.{token}"]) as wire:
            assert wire.subprotocol == "magmatch.1"
        statuses = [service.ask("/health")[0] for _ in range(30)]
        assert statuses[0] == 200
        status, headers, said = service.ask("/health")
        assert status == 429
        assert int(headers["retry-after"]) >= 1
        assert is_a_sentence_of_its_own(json.loads(said)["message"])
        assert token not in service.words()
        # Who is refused writes nothing into its log.
        assert "handshake" not in service.words()
