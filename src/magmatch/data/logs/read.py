# SPDX-License-Identifier: BSD-3-Clause
"""Read a recorder log: choose topics, decode them, settle the clock, find where the sensor sits."""

import logging
from pathlib import Path

import numpy as np

from magmatch.data.formats.extrinsic import read_extrinsic
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import load_trajectory
from magmatch.data.formats.recording import Recording
from magmatch.data.logs.choose import choose_topics, is_static, trees, trees_of_poses
from magmatch.data.logs.frames import FrameTree, distinct_seconds, frame_tree, trajectory_of
from magmatch.data.logs.log import Log, Topic
from magmatch.data.logs.messages import Entries, Frames
from magmatch.data.logs.mount import find_mount, merged, tell_differing, with_description
from magmatch.data.logs.number_topics import read_numbers
from magmatch.data.logs.open import opened_log
from magmatch.data.logs.streams import TopicStream, in_order, read_streams, settle_clock
from magmatch.data.trajectory import Trajectory
from magmatch.data.units import METRE_PER_UNIT, TESLA_PER_UNIT
from magmatch.errors import ConfigurationError, DataFormatError

logger = logging.getLogger(__name__)


def read_log(path: str | Path, layout: SurveyFormat, *, with_channels: bool = False) -> Recording:
    """Read field and poses of the sensor from a bag or an MCAP file, each at its own times.

    ``layout`` names topics, frames and extrinsic where they are not to be chosen; ``with_channels`` also reads topics
    of plain numbers, such as currents. Raises `DataFormatError` where the log is damaged or lacks the topics.
    """
    with opened_log(path) as log:
        return _recording(log, layout, with_channels=with_channels)


def _recording(log: Log, layout: SurveyFormat, *, with_channels: bool) -> Recording:
    topics = log.topics()
    field_topic, pose_topic, frames = choose_topics(log.path, topics, layout)
    moving = trees_of_poses(pose_topic, frames, layout)
    wanted = [field_topic, *([pose_topic] if pose_topic else []), *moving]
    logger.info("%s: reading %s", log.path, ", ".join(topic.name for topic in wanted))
    read = read_streams(log, [*wanted, *filter(is_static, trees(frames))], recover=layout.recover)
    streams, static = settle_clock(log.path, read[: len(wanted)]), read[len(wanted) :]
    of_frames = streams[len(wanted) - len(moving) :]
    tell_differing(log.path, of_frames, "--pose-topic")
    if layout.extrinsic is None and layout.trajectory is None:
        tell_differing(log.path, static, "--extrinsic")
    tree = frame_tree(log.path, merged(of_frames), merged(static))
    field = in_order(log.path, field_topic.name, _of_one_frame(log.path, streams[0]))
    sensor = field.frames[0]
    if moving and sensor not in tree.frames():
        tree = with_description(log, frames, tree)
    trajectory, (fixed, body), has_orientations = _poses(
        log.path, layout, streams[1] if pose_topic else None, tree, sensor
    )
    is_turned = bool(sensor) and sensor == fixed
    frame = layout.field_frame if "field_frame" in layout.model_fields_set else ("survey" if is_turned else "sensor")
    T_body_sensor = None
    if layout.extrinsic is not None:
        T_body_sensor = read_extrinsic(layout.extrinsic)
    elif frame == "sensor" and sensor != body:
        T_body_sensor = find_mount(log, frames, tree, fixed, body, sensor)
    times, is_new = distinct_seconds(field)
    delay_ns = float(np.median(field.log_ns - field.stamp_ns))  # of logging, behind the times used
    return Recording(
        path=log.path,
        times=times[is_new],
        field=layout.turned(field.values[is_new] * TESLA_PER_UNIT[layout.field_unit]),
        trajectory=trajectory,
        field_frame=frame,
        has_orientations=has_orientations,
        frame=fixed or "survey",
        poses_from=layout.trajectory,
        channels=read_numbers(log, topics, delay_ns) if with_channels else {},
    ).carried(T_body_sensor)


def _poses(
    path: Path, layout: SurveyFormat, stream: TopicStream | None, tree: FrameTree, sensor: str
) -> tuple[Trajectory, Frames, bool]:
    """Poses from another file, a topic or the tree of frames; their frames ("" where unknown); if they have turns."""
    metre = METRE_PER_UNIT[layout.length_unit]
    if layout.trajectory is not None:
        return load_trajectory(layout.trajectory, layout), ("", ""), True
    if stream is not None:
        entries = in_order(path, stream.topic.name, _of_one_frame(path, stream))
        return trajectory_of(path, entries).scaled(metre), entries.frames, entries.values.shape[1] == 7
    fixed, body = _pose_frames(layout.pose_frames) if layout.pose_frames else (tree.root_over(sensor), sensor)
    if fixed == body:
        known = ", ".join(tree.frames()[:12])
        message = f"tf does not know {sensor!r}, the frame of the field; it knows {known}: --pose-frames MAP,BODY"
        raise DataFormatError(path, message)
    logger.info("%s: poses of %s in %s from tf", path, body, fixed)
    return tree.trajectory(path, fixed, body).scaled(metre), (fixed, body), True


def _pose_frames(text: str) -> Frames:
    """Two names of frames."""
    names = [name.strip().lstrip("/") for name in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        msg = f"--pose-frames: expected two frames such as map,base_link; found '{text}'"
        raise ConfigurationError(msg)
    return names[0], names[1]


def _of_one_frame(path: Path, stream: TopicStream) -> Entries:
    """The entries of a topic that should speak of one thing; others are counted."""
    entries = stream.largest
    n, n_other = len(entries.number), len(stream) - len(entries.number)
    if n_other:
        logger.warning(
            "%s: %s holds several frames; read are the %d messages of %s, not the other %d",
            path, stream.topic.name, n, " -> ".join(filter(None, entries.frames)) or "none", n_other,
        )  # fmt: skip
    return entries


def list_topics(path: str | Path, layout: SurveyFormat) -> tuple[list[Topic], dict[str, str | None]]:
    """Topics of a log by name, and those that `read_log` would read as ``field`` and ``poses`` (None: no such)."""
    with opened_log(path) as log:
        topics = log.topics()
        try:
            field, pose, frames = choose_topics(log.path, topics, layout)
        except DataFormatError as error:
            logger.info("%s", error)
            return topics, {"field": None, "poses": None}
    poses = pose or next(iter(trees_of_poses(pose, frames, layout)), None)
    return topics, {"field": field.name, "poses": poses.name if poses else None}
