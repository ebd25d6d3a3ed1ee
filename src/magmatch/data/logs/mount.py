# SPDX-License-Identifier: BSD-3-Clause
"""The sensor's place on the body: it is looked for in tf_static, in tf, and in the robot's description."""

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.logs.choose import DESCRIPTION, is_description, is_static, moving_trees
from magmatch.data.logs.frames import FrameTree, extremes, fixed_edges, is_constant, path_between
from magmatch.data.logs.log import Log, Topic
from magmatch.data.logs.messages import Entries, Frames, MalformedError, decode
from magmatch.data.logs.streams import TopicStream, read_streams
from magmatch.errors import DataFormatError

logger = logging.getLogger(__name__)


def merged(streams: Sequence[TopicStream]) -> dict[Frames, Entries]:
    """Edges of several topics; one that several have is taken from the first."""
    return {frames: part for stream in reversed(streams) for frames, part in stream.entries.items()}


def tell_differing(path: Path, streams: Sequence[TopicStream], remedy: str) -> None:
    """Say which frame several topics place differently, or one of static transforms in the course of the log."""
    among: dict[Frames, list[TopicStream]] = {}
    for stream in streams:
        for frames in stream.entries:
            among.setdefault(frames, []).append(stream)
    differ = [frames for frames, some in among.items() if _do_differ(some, frames)]
    if differ:
        (parent, child), names = differ[0], [stream.topic.name for stream in among[differ[0]]]
        words = "%s: messages of %s place %r on %r differently; %s (%s)"
        taken = f"{names[0]} is read" if names[1:] else "the last one holds for the whole log"
        logger.warning(words, path, " and ".join(names), child, parent, taken, remedy)


def _do_differ(streams: Sequence[TopicStream], frames: Frames) -> bool:
    """Whether topics contradict each other about an edge, or one of static transforms itself."""
    values = [stream.entries[frames].values for stream in streams]
    if is_static(streams[0].topic):
        return not is_constant(np.vstack(values))
    if len(values) == 1 or is_constant(np.vstack(values)):
        return False
    first, *others = (set(map(tuple, part.tolist())) for part in values)
    # A topic that passes on another one repeats most of what it says.
    return any(2 * len(first & more) < min(len(first), len(more)) for more in others)


def find_mount(
    log: Log, topics: Sequence[Topic], tree: FrameTree, fixed: str, body: str, sensor: str
) -> RigidTransform | None:
    """``T_body_sensor``; None, said aloud, where no place in the log tells it.

    ``tree`` is what has been read of tf so far; the rest is read only where that does not connect the two.
    """
    T_body_sensor = tree.static_transform(body, sensor)
    if T_body_sensor is not None:
        return T_body_sensor
    entries = _unread(log, moving_trees(topics)) if sensor and (fixed or body) else {}
    tree = replace(tree, static=fixed_edges(entries, {}) | tree.static)
    moving = {*tree.moving, *entries} - tree.static.keys()
    tree = with_description(log, topics, tree)
    T_body_sensor = tree.static_transform(body, sensor)
    if T_body_sensor is None:
        edges = [*tree.static, *moving]
        is_moving = path_between(edges, body, sensor) is not None
        says = "tf moves" if is_moving else "nothing says where"
        on = repr(body) if body else "the body whose poses these are"
        what = repr(sensor) if sensor else "the sensor (its messages name no frame)"
        is_in_tf = fixed != sensor and path_between(edges, fixed, sensor) is not None
        logger.warning(
            "%s: %s %s %s %s; the poses are taken as the magnetometer's own (%s)",
            log.path, says, what, "against" if is_moving else "sits on", on,
            f"--pose-frames {fixed},{sensor} takes them from tf" if is_in_tf else "--extrinsic",
        )  # fmt: skip
    return T_body_sensor


def with_description(log: Log, topics: Sequence[Topic], tree: FrameTree) -> FrameTree:
    """The tree, with the fixed joints of the robot's description (URDF) where tf does not state them."""
    wanted = {topic.channel for topic in topics if is_description(topic)}
    joints: dict[Frames, RigidTransform] = {}
    for channel, _, payload in log.messages({c.topic for c in wanted}) if wanted else ():
        if channel in wanted:
            with suppress(MalformedError, AttributeError):
                joints |= _fixed_joints(log.path, str(decode(channel, payload).data))
    return replace(tree, static={edge: T for edge, T in joints.items() if edge not in tree.moving} | tree.static)


def _unread(log: Log, topics: Sequence[Topic]) -> dict[Frames, Entries]:
    """Edges of topics that nothing but a mount is asked of; what is damaged of them is left aside."""
    try:
        return merged(read_streams(log, topics, recover=True, thin=extremes)) if topics else {}
    except DataFormatError as error:
        logger.warning("%s", error)
        return {}


def _fixed_joints(path: Path, words: str) -> dict[Frames, RigidTransform]:
    """Transforms of the joints of a URDF that do not move, by names of links."""
    if "<!ENTITY" in words:
        return {}
    found = {}
    try:
        for joint in ElementTree.fromstring(words).iter("joint"):
            ends = [joint.find(end) for end in ("parent", "child")]
            if joint.get("type") != "fixed" or None in ends:
                continue
            origin = joint.find("origin")
            texts = ["0 0 0" if origin is None else origin.get(name) or "0 0 0" for name in ("xyz", "rpy")]
            xyz, rpy = ([float(word) for word in text.split()] for text in texts)
            if (len(xyz), len(rpy)) != (3, 3):
                msg = f"expected three numbers each in xyz and rpy, found {texts}"
                raise ValueError(msg)  # noqa: TRY301
            parent, child = (end.get("link", "").lstrip("/") for end in ends if end is not None)
            found[parent, child] = RigidTransform.from_components(xyz, Rotation.from_euler("xyz", rpy))
    except (ElementTree.ParseError, ValueError) as error:
        logger.warning("%s: its %s cannot be read (%s)", path, DESCRIPTION, error)
    return found
