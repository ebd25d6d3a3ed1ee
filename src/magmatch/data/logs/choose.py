# SPDX-License-Identifier: BSD-3-Clause
"""The choice of the topics to read: by type, and among several by one rule."""

import itertools
import logging
from collections.abc import Iterable, Sequence
from pathlib import Path

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.logs.log import Topic
from magmatch.data.logs.messages import ENCODINGS, TREES
from magmatch.errors import DataFormatError

logger = logging.getLogger(__name__)

FIELD_TYPES = ("sensor_msgs/MagneticField",)
# Old drivers send the field as a plain vector; so do many other sensors, so it must be named.
FIELD_TYPES_IF_NAMED = (*FIELD_TYPES, "geometry_msgs/Vector3Stamped")
POSE_TYPES = (
    "nav_msgs/Odometry",
    "geometry_msgs/PoseStamped",
    "geometry_msgs/PoseWithCovarianceStamped",
    "geometry_msgs/TransformStamped",
    "geometry_msgs/PointStamped",
)
DESCRIPTION, STRING = "robot_description", "std_msgs/String"
# What names say of poses that someone sets, for a body to go to or to start at: it is nowhere on the path between.
SET_POSES = ("goal", "setpoint", "target", "waypoint", "initialpose", "initial_pose", "clicked_point")


def choose_topics(path: Path, topics: list[Topic], layout: SurveyFormat) -> tuple[Topic, Topic | None, list[Topic]]:
    """Choose the topics of the field, of the poses (None where they come from tf), and of the same robot's frames.

    Names that are asked for overrule. Of all pairs of a field and a pose topic that share some time, those that share
    the longest namespace, as the topics of one robot among several do; of these the one with the most messages logged
    in the time that both cover (taken as evenly spread over each topic's own time); of equal ones the first by name.
    Poses that someone sets, such as goals, are taken only where no other topic and no tf has poses. Without poses:
    the field topic with the most messages. DataFormatError lists what there is.
    """
    moving = trees_of_poses(None, topics, layout)
    is_elsewhere = layout.trajectory is not None or layout.pose_frames is not None
    if layout.pose_topic is not None:
        has_own = not any(is_named(topic, layout.pose_topic) and topic.type in TREES for topic in topics)
    else:
        has_own = any(t.type in POSE_TYPES and t.encoding in ENCODINGS and may_be_path(t) for t in topics)
    if has_own and not is_elsewhere:
        field, pose = _choose(path, topics, layout, needs_pose=True)
        # Goals may be set before the field is recorded, and poses be those of another robot.
        nearest = max((shared_namespace(field.name, topic.name) for topic in moving), default=0)
        is_own = pose and _shared((field, pose)) > 0 and shared_namespace(field.name, pose.name) >= nearest
        if layout.pose_topic is not None or not moving or is_own:
            return field, pose, _frames_near(path, topics, field, pose, layout)
    # Where poses are nowhere else, the choice says what is missing.
    field, pose = _choose(path, topics, layout, needs_pose=not (is_elsewhere or moving))
    return field, pose, _frames_near(path, topics, field, pose, layout)


def _choose(
    path: Path, topics: Sequence[Topic], layout: SurveyFormat, *, needs_pose: bool
) -> tuple[Topic, Topic | None]:
    """Choose one topic of the field and, where `needs_pose`, one of poses."""
    types = FIELD_TYPES_IF_NAMED if layout.mag_topic else FIELD_TYPES
    fields = _candidates(path, topics, layout.mag_topic, types, "field")
    near = layout.pose_topic or ""
    field = min(fields, key=lambda topic: (-shared_namespace(topic.name, near), -topic.count, topic.name))
    pose = None
    if needs_pose:
        poses = _candidates(path, topics, layout.pose_topic, POSE_TYPES, "pose")
        paths = [topic for topic in poses if layout.pose_topic is not None or may_be_path(topic)]
        pairs = sorted(itertools.product(fields, paths or poses), key=lambda pair: (pair[0].name, pair[1].name))
        field, pose = max(pairs, key=_rank)  # the first of equal ones
        if not paths:
            words = (
                "%s: topic of poses: %s is read: expected the path of a body, found only what looks like goals or "
                "starts; poses from elsewhere: --trajectory POSES.tum"
            )
            logger.warning(words, path, pose.name)
        _tell_choice(path, pose, poses, "of poses", "--pose-topic")
    _tell_choice(path, field, fields, "of the field", "--mag-topic")
    return field, pose


def may_be_path(topic: Topic) -> bool:
    """Whether poses may be the path of a body: a single one is a goal or a start, and so is what is named so."""
    return topic.count > 1 and not any(word in topic.name.lower() for word in SET_POSES)


def is_static(topic: Topic) -> bool:
    """Whether a topic is that of transforms that hold for good, of one robot or of one among several."""
    return topic.name.rsplit("/", 1)[-1] == "tf_static"


def trees(topics: Iterable[Topic]) -> list[Topic]:
    """Topics of tf messages that can be read."""
    return [topic for topic in topics if topic.type in TREES and topic.count and topic.encoding in ENCODINGS]


def moving_trees(topics: Iterable[Topic]) -> list[Topic]:
    """Topics of tf messages that can be read, but for those of transforms that hold for good."""
    return [topic for topic in trees(topics) if not is_static(topic)]


def trees_of_poses(pose: Topic | None, topics: Iterable[Topic], layout: SurveyFormat) -> list[Topic]:
    """Topics of tf that have the poses: none where another topic, or a file, has them."""
    return [] if pose is not None or layout.trajectory is not None else moving_trees(topics)


def is_description(topic: Topic) -> bool:
    """Whether a topic is that of a robot's description, and can be read."""
    is_text = topic.type == STRING and topic.encoding in ENCODINGS
    return is_text and topic.name.rsplit("/", 1)[-1] == DESCRIPTION


def shared_namespace(one: str, other: str) -> int:
    """Count the names with which the namespaces of two topics both begin."""
    pairs = zip(*(name.strip("/").split("/")[:-1] for name in (one, other)), strict=False)
    return len(list(itertools.takewhile(lambda pair: pair[0] == pair[1], pairs)))


def _frames_near(
    path: Path, topics: Sequence[Topic], field: Topic, pose: Topic | None, layout: SurveyFormat
) -> list[Topic]:
    """Topics of frames of the robot whose field and poses are read, nearest first.

    Several robots in one log give frames the same names. Those of one are on the topics that share the longest
    namespace with its field or poses, and on topics in a namespace above.
    """
    of = [field.name, pose.name if pose else layout.pose_topic or field.name]
    frames = [*trees(topics), *filter(is_description, topics)]
    shared = {topic.name: max(shared_namespace(topic.name, name) for name in of) for topic in frames}
    levels = {max(shared.values(), default=0)}
    near = [topic for topic in frames if shared[topic.name] in levels | {shared_namespace(topic.name, topic.name)}]
    others = [topic.name for topic in frames if topic not in near]
    if others and layout.pose_topic is None:
        words = "%s: topics of frames: read are %s, of the robot with %s, not %s (--pose-topic)"
        logger.warning(words, path, ", ".join(topic.name for topic in near), field.name, ", ".join(others))
    return sorted(near, key=lambda topic: -shared[topic.name])


def is_named(topic: Topic, name: str) -> bool:
    """Whether a topic has a name, with or without the slash in front."""
    return topic.name.lstrip("/") == name.lstrip("/")


def _tell_choice(path: Path, chosen: Topic, among: Sequence[Topic], what: str, flag: str) -> None:
    """Say that there was a choice."""
    if len(among) > 1:
        others = ", ".join(topic.name for topic in among if topic is not chosen)
        logger.warning("%s: topic %s: %s is read, not %s (%s)", path, what, chosen.name, others, flag)


def describe_topics(topics: Sequence[Topic]) -> str:
    """List what a log holds, for a message."""
    shown = [f"{topic.name} ({topic.type}, {topic.count})" for topic in topics[:8]]
    return (", ".join(shown) or "none") + (f" and {len(topics) - 8} more" if len(topics) > 8 else "")


def _candidates(
    path: Path, topics: Sequence[Topic], name: str | None, types: Sequence[str], what: str
) -> list[Topic]:
    """Topics that may serve."""
    flag = "--mag-topic" if what == "field" else "--pose-topic"
    named = [topic for topic in topics if name is None or is_named(topic, name)]
    if not named and name is not None:
        raise DataFormatError(path, f"{flag} {name}: no such topic; the log holds {describe_topics(topics)}")
    typed = [topic for topic in named if topic.type in types]
    if not typed:
        expected = f"expected a {what} topic ({', '.join(types)}), found {describe_topics(named)}"
        raise DataFormatError(path, f"{expected}{_remedy(topics, what)}")
    readable = [topic for topic in typed if topic.encoding in ENCODINGS]
    if not readable:
        message = f"{typed[0].name} is encoded as {typed[0].encoding!r}, expected {', '.join(ENCODINGS)}"
        raise DataFormatError(path, message)
    filled = [topic for topic in readable if topic.count]
    if not filled:
        raise DataFormatError(path, f"{what} topic {readable[0].name} holds no messages")
    return filled


def _remedy(topics: Sequence[Topic], what: str) -> str:
    """Say what helps a log without a topic of the usual types, as far as it holds anything that could."""
    if what == "pose":
        tf = ", or --pose-frames MAP,BODY" if any(topic.type in TREES for topic in topics) else ""
        return f"; poses from elsewhere: --trajectory POSES.tum{tf}"
    may_be = [topic.name for topic in topics if topic.type in FIELD_TYPES_IF_NAMED and topic.count]
    may_be.sort(key=lambda name: "mag" not in name.lower())
    also = f" (or {', '.join(may_be[1:8])})" if may_be[1:] else ""
    return f"; if vectors of the field are on it: --mag-topic {may_be[0]}{also}" if may_be else ""


def _rank(pair: tuple[Topic, Topic]) -> tuple[bool, int, float]:
    """How likely a field and poses are of one robot: do they share time, how much namespace, how many messages."""
    n_messages = _shared(pair)
    return n_messages > 0, shared_namespace(*(topic.name for topic in pair)), n_messages


def _shared(pair: tuple[Topic, Topic]) -> float:
    """Messages of both topics in the time that both cover."""
    shared = min(topic.last_ns for topic in pair) - max(topic.first_ns for topic in pair)
    spans = [(topic.count, topic.last_ns - topic.first_ns) for topic in pair]
    return sum(n * (shared / span if span else 1.0) for n, span in spans) if shared >= 0 else 0.0
