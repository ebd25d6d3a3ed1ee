# SPDX-License-Identifier: BSD-3-Clause
"""Messages of one topic as a stream: intact messages only, on one clock, in order of time."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from magmatch.data.logs.log import Log, Topic
from magmatch.data.logs.messages import TREES, Decoder, Entries, Fault, Frames
from magmatch.data.tables.table import MAX_NORM_ERROR
from magmatch.data.tables.times import SECOND
from magmatch.data.units import DAMAGED
from magmatch.errors import DataFormatError
from magmatch.typing import Indices

logger = logging.getLogger(__name__)

# Messages of several publishers reach the recorder a little out of order; a larger step back is a clock set anew.
MAX_STEP_BACK_NS = SECOND
# A reading that comes late makes a few turns among those in order; readings of a clock set back make two at each.
FEW_TURNS = 5
# Header stamps and log times differ by the transport, some ms; more is two clocks.
ODD_DELAY_NS = SECOND


@dataclass(frozen=True, slots=True)
class TopicStream:
    """Whole messages of one topic, by the frames they name."""

    topic: Topic
    entries: dict[Frames, Entries]

    def __len__(self) -> int:
        return sum(len(part.number) for part in self.entries.values())

    @property
    def largest(self) -> Entries:
        """The entries of the frames that most messages name; of equal ones the first by name."""
        return min(self.entries.values(), key=lambda part: (-len(part.number), part.frames))

    def changed(self, change: Callable[[Entries], Entries]) -> "TopicStream":
        """The stream with all its entries changed; frames that are left without any go."""
        entries = {frames: change(part) for frames, part in self.entries.items()}
        return replace(self, entries={frames: part for frames, part in entries.items() if len(part.number)})


def read_streams(
    log: Log, topics: Sequence[Topic], *, recover: bool, thin: Callable[[Entries], Entries] | None = None
) -> list[TopicStream]:
    """Read the whole messages of some topics in one pass over the log.

    DataFormatError names the first message that is damaged or holds no numbers; with `recover` these are left out.
    `thin` leaves few of the whole messages of an edge, wherever not all are needed.
    """
    thinned = None if thin is None else lambda part: thin(_whole(part, []))
    decoders = {topic.channel: Decoder(thinned) for topic in topics}
    for channel, log_ns, payload in log.messages({topic.name for topic in topics}):
        if channel in decoders:
            decoders[channel].take(channel, log_ns, payload)
    return [_stream(log.path, topic, decoders[topic.channel], recover=recover) for topic in topics]


def _stream(path: Path, topic: Topic, decoder: Decoder, *, recover: bool) -> TopicStream:
    """Give what was decoded, or raise the first fault."""
    faults = decoder.faults
    stream = TopicStream(topic, decoder.entries()).changed(lambda part: _whole(part, faults))
    if faults:
        (first, fault), n = min(faults), len({number for number, _ in faults})
        words = f"{topic.name}, message {first}: {fault}"
        if not stream.entries:
            raise DataFormatError(path, f"{words}; none of its {n} messages is a whole {topic.type}")
        if not recover:
            raise DataFormatError(path, f"{words} ({n} such messages; --recover leaves them out)")
        logger.warning("%s: left out %d messages that are no whole %s (%s)", path, n, topic.type, words)
    if not stream.entries:
        raise DataFormatError(path, f"{topic.name} holds no whole message of type {topic.type}")
    return stream


def _whole(part: Entries, faults: list[Fault]) -> Entries:
    """Entries that hold numbers, and unit quaternions where they hold one."""
    is_number = (np.abs(part.values) < DAMAGED).all(axis=1)  # false of NaN too
    for i in np.flatnonzero(~is_number).tolist():
        most = np.abs(part.values[i]).max()
        words = f"holds a number of {most:.3g}" if np.isfinite(most) else "holds NaN or infinity"
        faults.append((int(part.number[i]), words))
    part = part.at(is_number)
    if part.values.shape[1] == 3:
        return part
    norms = np.linalg.norm(part.values[:, 3:], axis=1)
    is_turn = np.abs(norms - 1) <= MAX_NORM_ERROR
    for i in np.flatnonzero(~is_turn).tolist():
        words = f"expected a unit quaternion, found one of length {norms[i]:.4g}"
        faults.append((int(part.number[i]), words))
    return part.at(is_turn)


def settle_clock(path: Path, streams: Sequence[TopicStream]) -> list[TopicStream]:
    """Streams to be joined, with the times to use in ``stamp_ns``: header stamps, or log times for all.

    Log times are used where the headers of one stream have no stamps, or cut ones, or those of two streams share no
    time.
    """
    if unstamped := [s.topic.name for s in streams if not any((e.stamp_ns > 0).any() for e in s.entries.values())]:
        logger.warning("%s: the headers of %s have no stamps; log times are used", path, ", ".join(unstamped))
        return _by_log_times(streams)
    if cut := [stream.topic.name for stream in streams if _are_stamps_cut(stream)]:
        words = "%s: most messages of %s share their header stamps, as if cut to whole seconds; log times are used"
        logger.warning(words, path, ", ".join(cut))
        return _by_log_times(streams)
    # Zero stands for no stamp, unless the message was logged at zero too: simulated clocks begin there.
    kept = [
        s.changed(lambda part: part.at((part.stamp_ns > 0) | ((part.stamp_ns | part.log_ns) == 0))) for s in streams
    ]
    for before, after in zip(streams, kept, strict=True):
        if n := len(before) - len(after):
            logger.warning("%s: left out %d messages of %s without a stamp", path, n, before.topic.name)
    behind = {s.topic.name: [part.log_ns - part.stamp_ns for part in s.entries.values()] for s in kept}
    delays = {name: float(np.median(np.concatenate(parts))) if parts else 0.0 for name, parts in behind.items()}
    odd = {name: delay for name, delay in delays.items() if abs(delay) > ODD_DELAY_NS}
    are_apart = bool(odd) and max(delays.values()) - min(delays.values()) > ODD_DELAY_NS
    names = " and ".join(delays)
    if are_apart and _share_no_time(kept):
        logger.warning("%s: the header stamps of %s share no time: two clocks; log times are used", path, names)
        return _by_log_times(streams)
    for name, delay in odd.items():
        logger.warning(
            "%s: %s was logged %.3g s after its header stamps (median): two clocks? Header stamps are used",
            path, name, delay / 1e9,
        )  # fmt: skip
    if are_apart:
        logger.warning("%s: the header stamps of %s lie on different clocks", path, names)
    return kept


def _are_stamps_cut(stream: TopicStream) -> bool:
    """Whether most readings of a topic share their stamp with others, as if cut to whole seconds.

    Log times must tell them apart: those of readings sent in batches, or recorded twice, come in bursts. A message
    that was sent again, numbers and all, is no reading. Edges of tf are sent again whenever another one is.
    """
    part = stream.largest
    part = part.at(part.stamp_ns > 0)
    stamps, which = np.unique(part.stamp_ns, return_inverse=True)
    if stream.topic.type in TREES or 2 * len(stamps) >= len(which):
        return False
    n_readings = len(np.unique(np.column_stack([which, part.values]), axis=0))
    intervals = np.diff(np.sort(part.log_ns))
    return 2 * len(stamps) < n_readings and bool(2 * np.median(intervals) > np.mean(intervals))


def _by_log_times(streams: Sequence[TopicStream]) -> list[TopicStream]:
    return [stream.changed(lambda part: replace(part, stamp_ns=part.log_ns)) for stream in streams]


def _share_no_time(streams: Sequence[TopicStream]) -> bool:
    """Whether no time lies within the header stamps of all streams."""
    stamps = [np.concatenate([part.stamp_ns for part in s.entries.values()]) for s in streams if len(s)]
    return max(int(t.min()) for t in stamps) > min(int(t.max()) for t in stamps)


def in_order(path: Path, topic: str, entries: Entries) -> Entries:
    """Entries by increasing time in ``stamp_ns``, each time once; refused where the clock was set back.

    Files may hold messages in any order, so stamps are compared in the order of logging too.
    """
    stored = _behind(entries.stamp_ns)
    by_log = entries.stamp_ns[np.argsort(entries.log_ns, kind="stable")]
    orders = (_behind(by_log), by_log), (stored, entries.stamp_ns)
    back, stamps = min(orders, key=lambda one: one[0].max(initial=0))
    is_stored_late = stored > MAX_STEP_BACK_NS
    if back.max(initial=0) > MAX_STEP_BACK_NS or (is_stored_late.any() and _is_logged_twice(entries)):
        i = int(np.argmax(is_stored_late))
        message = (
            f"{topic}, message {entries.number[i]}: time runs backward by {stored[i] / 1e9:.3g} s; "
            "a clock that was set anew, or two recordings in one?"
        )
        raise DataFormatError(path, message)
    if _turns_after_step(stamps) > FEW_TURNS:
        words = (
            "%s: time on %s runs backward by %.3g s at %.3f s, and messages from before and after are mixed: a clock "
            "that was set anew? Cut the log in two there"
        )
        logger.warning(words, path, topic, back.max() / 1e9, stamps[np.diff(stamps).argmin()] / 1e9)
    elif n_late := int((back > 0).sum()):
        logger.warning("%s: %d messages of %s came out of order and were sorted by time", path, n_late, topic)
    entries = entries.at(np.lexsort((entries.log_ns, entries.stamp_ns)))
    is_new = np.concatenate([[True], np.diff(entries.stamp_ns) > 0])
    if n_twice := int((~is_new).sum()):
        logger.warning("%s: left out %d messages of %s whose time another one has", path, n_twice, topic)
    return entries.at(is_new)


def _behind(times: Indices) -> Indices:
    """Measure how far each time lies before the latest of those above it."""
    return np.asarray(np.maximum.accumulate(times) - times)


def _is_logged_twice(entries: Entries) -> bool:
    """Whether the recorder's own clock was set back once, so that messages from before and after lie in turns.

    Pieces of a file that were written in another order do not overlap in time; messages in no order at all step
    back more than once.
    """
    n_turns = _turns_after_step(entries.log_ns, MAX_STEP_BACK_NS)
    # A piece that belongs between two others makes two turns.
    return bool((n_turns - 2) * np.median(np.diff(np.sort(entries.log_ns))) > MAX_STEP_BACK_NS)


def _turns_after_step(times: Indices, least: int = 0) -> int:
    """Count how often times from before and after the only step back by more than `least` follow each other, sorted.

    Without a step back, or with several, it is 0.
    """
    is_back = np.diff(times) < -least
    if is_back.sum() != 1:
        return 0
    is_after = np.concatenate([[False], np.cumsum(is_back) > 0])
    return int(np.diff(is_after[np.argsort(times, kind="stable")]).sum())
