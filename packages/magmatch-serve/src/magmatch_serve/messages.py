# SPDX-License-Identifier: BSD-3-Clause
"""Samples and poses go over the wire, as JSON or as a compact binary form; docs/serve.md has the tables."""

import json
import struct
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from magmatch.compiled import compiled
from magmatch.data.document import adapter_of
from magmatch.data.tables.table import MAX_NORM_ERROR
from magmatch.errors import first_fault
from magmatch.localization.estimate import LocalizerStatus, PoseEstimate
from magmatch.number_text import told
from magmatch.typing import Scalars, Vectors
from magmatch_serve.refusals import RefusedError

Number = Annotated[float, Field(allow_inf_nan=False)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3)]
Four = Annotated[list[Number], Field(min_length=4, max_length=4)]

# Binary samples: t (s), position (m), quaternion xyzw, field (T). Little-endian.
SAMPLE = np.dtype([("t", "<f8"), ("pqb", "<f4", 10)])
# Binary poses: samples taken, status, t, probability, rows of T_map_body, upper triangle of the covariance by rows.
POSE = struct.Struct("<IB3xdd12d21f")
_HEAD, _NO_POSE = struct.Struct("<IB3xdd"), bytes(12 * 8 + 21 * 4)
STATUSES = tuple(LocalizerStatus)
_UPPER = np.triu_indices(6)
# m: from here on, single precision rounds by more than half a millimetre, which is no longer below odometry's noise.
MAX_SINGLE = 2.0**14


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Sample(_Message):
    """One sample: time (s), pose of the body in the odometry's frame (m; xyzw), field in the body's axes (T)."""

    t: Number
    position: Three
    orientation: Four
    field: Three


class Samples(_Message):
    """Several samples, oldest first, with one answer."""

    samples: Annotated[list[Sample], Field(min_length=1)]


class Hello(_Message):
    """The first message of a client."""

    type: Literal["hello"]
    # From an earlier welcome: resume that state. Without one, a new key is given.
    key: str | None = None
    # Forget the state, keep the key: the odometry begins anew.
    anew: bool = False
    # What the page calls it.
    name: Annotated[str, Field(max_length=40)] = ""
    answers: Literal["json", "binary"] = "json"


def read_hello(text: str) -> Hello:
    """Read a client's first message."""
    found: Hello = _valid(Hello, text)
    return found


def read_samples(message: str | bytes, most: int) -> tuple[Scalars, np.ndarray, Vectors]:
    """Read samples from a message of either form: times (n,), poses (n, 4, 4) and fields (n, 3)."""
    rows = _binary(message) if isinstance(message, bytes) else _json(message)
    if len(rows) > most:
        raise RefusedError(413, f"expected at most {most} samples in a message, found {len(rows)}")
    poses = np.zeros((len(rows), 4, 4))
    if (n := _poses_of(rows, MAX_NORM_ERROR, poses)) < len(rows):
        if not (is_finite := np.isfinite(rows[n])).all():
            name = ("t", *("position",) * 3, *("orientation",) * 4, *("field",) * 3)[int(np.argmin(is_finite))]
            words = f"{name}: expected finite numbers, found NaN or infinity; leave such samples out"
        else:
            found = float(np.linalg.norm(rows[n, 4:8]))
            words = f"orientation: expected a unit quaternion x, y, z, w, found one of norm {found:.3g}"
        raise RefusedError(422, words)
    return rows[:, 0], poses, rows[:, 8:]


@compiled
def _poses_of(rows, most_off, poses):  # type: ignore[no-untyped-def]
    """Write the poses of rows (n, 11) of time, position, quaternion x, y, z, w and field.

    Gives how many rows are fine: up to one that is not finite, or whose quaternion's length is off by more than told.
    """
    for n in range(len(rows)):
        row, T = rows[n], poses[n]
        norm = np.sqrt(row[4] ** 2 + row[5] ** 2 + row[6] ** 2 + row[7] ** 2)
        for k in range(11):
            if not np.isfinite(row[k]):
                return n
        if abs(norm - 1) > most_off:
            return n
        x, y, z, w = row[4] / norm, row[5] / norm, row[6] / norm, row[7] / norm
        T[0, 0], T[0, 1], T[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
        T[1, 0], T[1, 1], T[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
        T[2, 0], T[2, 1], T[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
        T[0, 3], T[1, 3], T[2, 3], T[3, 3] = row[1], row[2], row[3], 1.0
    return len(rows)


def _binary(message: bytes) -> np.ndarray:
    if not message or len(message) % SAMPLE.itemsize:
        words = f"expected a whole number of samples of {SAMPLE.itemsize} bytes each, found {len(message)} bytes"
        raise RefusedError(400, words)
    found = np.frombuffer(message, SAMPLE)
    rows = np.empty((len(found), 11))
    rows[:, 0], rows[:, 1:] = found["t"], found["pqb"]
    if len(far := rows[(np.abs(rows[:, 1:4]) >= MAX_SINGLE).any(axis=1), 1:4]):
        words = (
            f"position: expected less than {MAX_SINGLE / 1e3:.0f} km in each axis, which float32 can hold, found "
            f"{', '.join(told(v) for v in far[0])}; take the first position off all, or send JSON"
        )
        raise RefusedError(422, words)
    return rows


def _json(message: str) -> np.ndarray:
    # What pydantic says of a union names all of its members.
    found = _valid(Samples if '"samples"' in message[:20] else Sample, message)
    samples = found.samples if isinstance(found, Samples) else [found]
    return np.array([[s.t, *s.position, *s.orientation, *s.field] for s in samples])


def _valid(kind: type[Any], text: str) -> Any:
    try:
        return adapter_of(kind).validate_json(text)
    except ValidationError as error:
        if error.errors()[0]["type"] == "json_invalid":
            raise RefusedError(400, "expected a JSON object, found a message that is not JSON") from None
        place, words = first_fault(error)
        raise RefusedError(422, f"{place}: {words}" if place else words) from None


def write_sample(t: float, p: np.ndarray, q: np.ndarray, b: np.ndarray) -> bytes:
    """One sample in the binary form."""
    return np.array([(t, (*p, *q, *b))], SAMPLE).tobytes()


def pose_document(n: int, t: float, now: PoseEstimate) -> dict[str, Any]:
    """An estimate after n samples as a JSON answer; without a pose where none is stated."""
    said: dict[str, Any] = {
        "type": "pose", "n": n, "t": t, "status": now.status.value, "reason": now.reason,
        "probability": now.probability, "map": now.map,
    }  # fmt: skip
    if now.matrix is not None and now.covariance is not None:
        said |= {"T_map_body": now.matrix.tolist(), "covariance": now.covariance.tolist()}
    return said


def write_pose(n: int, t: float, now: PoseEstimate, *, binary: bool) -> str | bytes:
    """An estimate after n samples as an answer."""
    if not binary:
        return json.dumps(pose_document(n, t, now), allow_nan=False)
    head = _HEAD.pack(n & 0xFFFFFFFF, STATUSES.index(now.status), t, now.probability)
    if now.matrix is None or now.covariance is None:
        return head + _NO_POSE
    return head + now.matrix[:3].astype("<f8").tobytes() + now.covariance[_UPPER].astype("<f4").tobytes()


def read_pose(answer: str | bytes) -> dict[str, Any]:
    """An answer of either form as the JSON one's keys, as far as it has them."""
    if isinstance(answer, str):
        return dict(json.loads(answer))
    n, status, t, probability, *numbers = POSE.unpack(answer)
    said = {"type": "pose", "n": n, "t": t, "status": STATUSES[status].value, "probability": probability}
    if STATUSES[status] in {LocalizerStatus.LOCALIZED, LocalizerStatus.DEAD_RECKONING}:
        C = np.zeros((6, 6))
        C[_UPPER] = numbers[12:]
        T = np.vstack([np.reshape(numbers[:12], (3, 4)), [0, 0, 0, 1]])
        said |= {"T_map_body": T.tolist(), "covariance": (C + np.triu(C, 1).T).tolist()}
    return said
