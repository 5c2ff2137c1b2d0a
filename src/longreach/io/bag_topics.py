"""Which topic of a bag is which sensor: as the robot's description says, else the only one of the right type."""

from collections.abc import Mapping, Sequence
from itertools import islice

from longreach.errors import ConfigError, RecordingError
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
    "wrench": ("geometry_msgs/msg/WrenchStamped",),
}
# Where `write_bag` puts what no topic of a description is for; what is there is no sensor.
ESTIMATE, TOOL, PLAN = "/odometry/filtered", "/tool/", "/joint_trajectory"
SETTLED = "/odometry/settled"
# Topics that are taken where the description names none: those of `write_bag`.
USUAL = {"joints": "/arm/joint_states", "wrench": "/wrench"}
_FOUND_BY_TYPE = ("wheels", "lidar", "imu")
_NAMES_IN = 20  # messages to look for wheels in; several nodes may share a topic


def with_topics(robot: RobotDescription, topics: Mapping[str, str]) -> RobotDescription:
    """Return a description with other topics, as {"lidar": "/scan"}.

    Raises:
        ConfigError: there is no such sensor.
    """
    _check_sensors(topics)
    return robot.model_copy(update={"topics": robot.topics.model_copy(update=dict(topics))})


def choose_topics(
    bag: BagFile, robot: RobotDescription, truth_topic: str | None
) -> tuple[dict[str, Topic], tuple[str, ...]]:
    """Return the topic of each sensor that the bag has, by its name in `Topics`, and remarks.

    A topic that the description names must be there if the bag has an unused one of that type: its name is wrong then.
    Otherwise the bag lacks that sensor, which is a remark, as is a missing reference that was not asked for.

    Raises:
        RecordingError: a named topic is missing or of the wrong type, or there are several and none is named.
    """
    names = {role: getattr(robot.topics, role) for role in _TYPES}
    there = {(topic.name, topic.type) for topic in bag.topics if topic.name not in names.values()}
    names |= {role: name for role, name in USUAL.items() if names[role] is None and (name, _TYPES[role][0]) in there}
    if truth_topic is not None:
        names["truth"] = truth_topic
    chosen: dict[str, Topic] = {}
    sensed = [topic for topic in bag.topics if not topic.name.startswith((ESTIMATE, SETTLED, TOOL))]
    for role, name in names.items():
        others = {other for r, other in names.items() if r != role}
        free = [topic for topic in sensed if topic.type in _TYPES[role] and topic.name not in others]
        if any(topic.name == name for topic in bag.topics):
            chosen[role] = _named(bag, role, str(name))
        elif name is None and role in _FOUND_BY_TYPE and (topic := _only(bag, robot, role, free)) is not None:
            chosen[role] = topic
    remarks = []
    unused = [topic for topic in sensed if topic not in chosen.values()]
    for role in sorted(names.keys() - chosen.keys()):
        if (name := names[role]) is None:
            continue
        if name == truth_topic or (role != "truth" and any(topic.type in _TYPES[role] for topic in unused)):
            raise RecordingError(f"{bag.path} has no topic {name} for {role}; it has {listed(bag.topics)}.")
        remarks.append(f"There is no topic {name}, so the recording is read without {role}.")
    if "wheels" in chosen and chosen["wheels"].type == JOINT_STATE and robot.base is None:
        raise RecordingError(
            f"{chosen['wheels'].name} holds joints, but the description of {robot.name} has no base that names the "
            "wheels among them; describe its base, or name a topic of nav_msgs/msg/Odometry as topics.wheels."
        )
    return chosen, tuple(remarks)


def _check_sensors(topics: Mapping[str, str]) -> None:
    if unknown := sorted(topics.keys() - _TYPES.keys()):
        raise ConfigError(f"{unknown[0]} is no sensor that has a topic; there are {', '.join(_TYPES)}.")


def check_topics(bag: BagFile, topics: Mapping[str, str]) -> None:
    """Check that a bag has these topics of sensors, as {"lidar": "/scan"}.

    Raises:
        ConfigError: there is no such sensor.
        RecordingError: a topic is missing or of the wrong type.
    """
    _check_sensors(topics)
    for role, name in topics.items():
        if all(topic.name != name for topic in bag.topics):
            raise RecordingError(f"{bag.path} has no topic {name} for {role}; it has {listed(bag.topics)}.")
        _named(bag, role, name)


def listed(topics: Sequence[Topic]) -> str:
    """Return topics with their types as part of a sentence."""
    return ", ".join(f"{topic.name} ({topic.type})" for topic in topics) or "none with messages"


def _named(bag: BagFile, role: str, name: str) -> Topic:
    topics, types = [topic for topic in bag.topics if topic.name == name], _TYPES[role]
    right = [topic for topic in topics if topic.type in types]
    if len(right) != 1:
        found = " and ".join(topic.type for topic in topics)
        raise RecordingError(f"{bag.path}: {name} is of type {found}, but {role} are read from {' or '.join(types)}.")
    return right[0]


def _only(bag: BagFile, robot: RobotDescription, role: str, free: Sequence[Topic]) -> Topic | None:
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
