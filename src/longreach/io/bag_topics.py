"""Which topic of a bag is which sensor: as the robot's description says, else the only one of the right type."""

from collections.abc import Sequence
from itertools import islice

from longreach.errors import RecordingError
from longreach.io.bag_file import BagFile, Topic
from longreach.robot.description import RobotDescription

JOINT_STATE = "sensor_msgs/msg/JointState"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    ODOMETRY,
)
_TYPES = {
    "wheels": (JOINT_STATE, ODOMETRY),
    "lidar": ("sensor_msgs/msg/LaserScan",),
    "imu": ("sensor_msgs/msg/Imu",),
    "truth": (*_POSES, *TRANSFORMS),
    "fixes": _POSES,
    "joints": (JOINT_STATE,),
}
_FOUND_BY_TYPE = ("wheels", "lidar", "imu")
_NAMES_IN = 20  # messages to look for wheels in; several nodes may share a topic


def choose_topics(
    bag: BagFile, robot: RobotDescription, truth_topic: str | None
) -> tuple[dict[str, Topic], tuple[str, ...]]:
    """Return the topic of each sensor that the bag has, by its name in `Topics`, and remarks.

    A topic that the description names must be there if the bag has any topic of that type: its name is wrong then.
    Otherwise the bag lacks that sensor, which is a remark, as is a missing reference that was not asked for.

    Raises:
        RecordingError: a named topic is missing or of the wrong type, or there are several and none is named.
    """
    chosen: dict[str, Topic] = {}
    remarks = []
    for role, types in _TYPES.items():
        name = truth_topic if role == "truth" and truth_topic is not None else getattr(robot.topics, role)
        there = [topic for topic in bag.topics if topic.type in types]
        if name is None:
            topic = _only(bag, robot, role, there) if role in _FOUND_BY_TYPE else None
        elif any(topic.name == name for topic in bag.topics):
            topic = _named(bag, role, name, types)
        elif (role == "truth" and truth_topic is None) or not (there or name == truth_topic):
            topic = None
            remarks.append(f"There is no topic {name}, so the recording is read without {role}.")
        else:
            raise RecordingError(f"{bag.path} has no topic {name} for {role}; it has {listed(bag.topics)}.")
        if topic is not None:
            chosen[role] = topic
    if "wheels" in chosen and chosen["wheels"].type == JOINT_STATE and robot.base is None:
        raise RecordingError(
            f"{chosen['wheels'].name} holds joints, but the description of {robot.name} has no base that names the "
            "wheels among them; describe its base, or name a topic of nav_msgs/msg/Odometry as topics.wheels."
        )
    return chosen, tuple(remarks)


def listed(topics: Sequence[Topic]) -> str:
    """Return topics with their types as part of a sentence."""
    return ", ".join(f"{topic.name} ({topic.type})" for topic in topics) or "none with messages"


def _named(bag: BagFile, role: str, name: str, types: Sequence[str]) -> Topic:
    topics = [topic for topic in bag.topics if topic.name == name]
    right = [topic for topic in topics if topic.type in types]
    if len(right) != 1:
        found = " and ".join(topic.type for topic in topics)
        raise RecordingError(f"{bag.path}: {name} is of type {found}, but {role} are read from {' or '.join(types)}.")
    return right[0]


def _only(bag: BagFile, robot: RobotDescription, role: str, there: Sequence[Topic]) -> Topic | None:
    others = {name for other in _TYPES if (name := getattr(robot.topics, other)) is not None}
    free = [topic for topic in there if topic.name not in others]
    if role == "wheels" and robot.base is None:
        free = [topic for topic in free if topic.type == ODOMETRY]
    if role == "wheels" and robot.base is not None and len(free) > 1:
        wheels = set(robot.base.wheel_names)
        free = [topic for topic in free if topic.type == JOINT_STATE and wheels <= _names(bag, topic)] or free
    if len(free) > 1:
        raise RecordingError(
            f"{bag.path} has several topics that may be the {role}: {listed(free)}; name one as topics.{role} in the "
            "robot's description."
        )
    return free[0] if free else None


def _names(bag: BagFile, topic: Topic) -> set[str]:
    messages = islice(bag.messages({(topic.name, topic.type)}), _NAMES_IN)
    return {name for *_, message in messages for name in message.name}
