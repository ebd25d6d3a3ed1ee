# SPDX-License-Identifier: BSD-3-Clause
"""Messages of one topic as a stream: whole messages only, one clock, times in order."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from magmatch.data.logs.log import Channel, Log, Topic
from magmatch.data.logs.messages import Decoder, Entries, Faults, Frames
from magmatch.data.tables.quaternions import MAX_NORM_ERROR
from magmatch.errors import DataFormatError

logger = logging.getLogger(__name__)

MAX_NUMBER = 1e12  # no position or field in any unit comes near it; its square is still a number
# Messages of several publishers reach the recorder a little out of order; a larger step back is a clock set anew.
MAX_STEP_BACK_NS = 1_000_000_000
# Header stamps and log times differ by the transport, some ms; more is two clocks.
ODD_DELAY_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Stream:
    """Whole messages of one topic.

    Attributes
    ----------
    topic : Topic
    entries : dict
        By frames.
    """

    topic: Topic
    entries: dict[Frames, Entries]

    @property
    def is_stamped(self) -> bool:
        """Whether any header has a stamp."""
        return any(bool(part.stamp_ns.any()) for part in self.entries.values())

    @property
    def largest(self) -> Entries:
        """The entries of the frames that most messages name; of equal ones the first by name."""
        return min(self.entries.values(), key=lambda part: (-len(part.number), part.frames))


def read_streams(log: Log, topics: Sequence[Topic], *, recover: bool) -> list[Stream]:
    """Read the messages of some topics that are whole, in one pass over the log.

    Parameters
    ----------
    log : Log
        Open.
    topics : sequence of Topic
        Of types that can be decoded.
    recover : bool
        Leave out messages that are damaged or hold no numbers, instead of refusing.

    Returns
    -------
    list of Stream
        One for each topic.

    Raises
    ------
    DataFormatError
        Names the first message at fault.
    """
    decoders = {Channel(topic.name, topic.type, topic.encoding): Decoder() for topic in topics}
    for batch in log.messages({topic.name for topic in topics}):
        if batch.channel in decoders:
            decoders[batch.channel].take(batch)
    return [
        _stream(log.path, topic, decoder, recover=recover)
        for topic, decoder in zip(topics, decoders.values(), strict=True)
    ]


def _stream(path: Path, topic: Topic, decoder: Decoder, *, recover: bool) -> Stream:
    """What was decoded, or the first fault."""
    faults = decoder.faults
    entries = {frames: _whole(part, faults) for frames, part in decoder.entries().items()}
    entries = {frames: part for frames, part in entries.items() if len(part.number)}
    if faults.numbers:
        first, n = min(faults.numbers), len(set(faults.numbers))
        words = f"{topic.name}, message {first}: {faults.words[0]}"
        if not recover:
            message = f"{words} ({n} such messages; --recover leaves them out)"
            raise DataFormatError(path, message)
        logger.warning("%s: left out %d messages that are no whole %s (%s)", path, n, topic.type, words)
    if not entries:
        raise DataFormatError(path, f"{topic.name} holds no whole message of type {topic.type}")
    return Stream(topic, entries)


def _whole(part: Entries, faults: Faults) -> Entries:
    """Entries that hold numbers, and unit quaternions where they hold one."""
    is_whole = (np.abs(part.values) < MAX_NUMBER).all(axis=1)  # false of NaN too
    if not is_whole.all():
        found = part.values[~is_whole][0]
        faults.numbers.extend(part.number[~is_whole].tolist())
        faults.words.append(
            "holds NaN or infinity"
            if not np.isfinite(found).all()
            else f"holds a number of {np.abs(found).max():.3g}"
        )
    if part.values.shape[1] == 7:
        norms = np.linalg.norm(np.where(is_whole[:, None], part.values[:, 3:], 1.0), axis=1)
        is_turn = ~is_whole | (np.abs(norms - 1) <= MAX_NORM_ERROR)
        if not is_turn.all():
            found = float(norms[np.argmin(is_turn)])
            faults.numbers.extend(part.number[~is_turn].tolist())
            faults.words.append(f"expected a unit quaternion, found one of length {found:.4g}")
            is_whole &= is_turn
    return part if is_whole.all() else _subset(part, is_whole)


def settle_clock(path: Path, streams: Sequence[Stream]) -> list[Stream]:
    """Take header stamps as times, or log times of all streams where one has no stamps.

    Parameters
    ----------
    path : Path
        The log, for messages.
    streams : sequence of Stream
        To be joined, hence on one clock.

    Returns
    -------
    list of Stream
        With the times to use in ``stamp_ns``.
    """
    unstamped = [stream.topic.name for stream in streams if not stream.is_stamped]
    if unstamped:
        logger.warning("%s: the headers of %s have no stamps; log times are used", path, ", ".join(unstamped))
        return [_map(stream, lambda part: replace(part, stamp_ns=part.log_ns)) for stream in streams]
    kept = [_map(stream, lambda part: _subset(part, _has_stamp(part))) for stream in streams]
    for before, after in zip(streams, kept, strict=True):
        n = sum(len(part.number) for part in before.entries.values())
        n -= sum(len(part.number) for part in after.entries.values())
        if n:
            logger.warning("%s: left out %d messages of %s without a stamp", path, n, before.topic.name)
    delays = {s.topic.name: _delay_ns(s) for s in kept}
    odd = {name: delay for name, delay in delays.items() if abs(delay) > ODD_DELAY_NS}
    for name, delay in odd.items():
        logger.warning(
            "%s: %s was logged %.3g s after its header stamps (median): two clocks? Header stamps are used",
            path, name, delay / 1e9,
        )  # fmt: skip
    if odd and max(delays.values()) - min(delays.values()) > ODD_DELAY_NS:
        logger.warning("%s: the header stamps of %s lie on different clocks", path, " and ".join(delays))
    return kept


def in_order(path: Path, topic: str, entries: Entries) -> Entries:
    """Entries by increasing time, each time once.

    Parameters
    ----------
    path, topic
        For messages.
    entries : Entries
        Times in ``stamp_ns``.

    Returns
    -------
    Entries

    Raises
    ------
    DataFormatError
        The clock was set back by more than a second.
    """
    back = np.maximum.accumulate(entries.stamp_ns) - entries.stamp_ns
    if back.max(initial=0) > MAX_STEP_BACK_NS:
        i = int(np.argmax(back > MAX_STEP_BACK_NS))
        message = (
            f"{topic}, message {entries.number[i]}: time runs backward by {back[i] / 1e9:.3g} s; "
            "a clock that was set anew, or two recordings in one?"
        )
        raise DataFormatError(path, message)
    n_late = int((back > 0).sum())
    if n_late:
        logger.warning("%s: %d messages of %s came out of order and were sorted by time", path, n_late, topic)
    entries = _subset(entries, np.argsort(entries.stamp_ns, kind="stable"))
    is_new = np.concatenate([[True], np.diff(entries.stamp_ns) > 0])
    if not is_new.all():
        n_twice = int((~is_new).sum())
        logger.warning("%s: left out %d messages of %s whose time another one has", path, n_twice, topic)
        entries = _subset(entries, is_new)
    return entries


def _has_stamp(part: Entries) -> np.ndarray:
    """Zero stands for no stamp, but for a moment where the message was logged at zero too: simulated clocks."""
    return np.asarray((part.stamp_ns > 0) | ((part.stamp_ns == 0) & (part.log_ns == 0)))


def _delay_ns(stream: Stream) -> float:
    delays = [part.log_ns - part.stamp_ns for part in stream.entries.values()]
    return float(np.median(np.concatenate(delays))) if delays else 0.0


def _map(stream: Stream, change: Callable[[Entries], Entries]) -> Stream:
    entries = {frames: change(part) for frames, part in stream.entries.items()}
    return replace(stream, entries={frames: part for frames, part in entries.items() if len(part.number)})


def _subset(part: Entries, rows: np.ndarray) -> Entries:
    return Entries(part.frames, part.number[rows], part.log_ns[rows], part.stamp_ns[rows], part.values[rows])
