"""Under which keys what is sent, laid out as ROS 2's zenoh middleware (rmw_zenoh) does it.

A topic's key is domain/name/type/hash, its payload CDR. Source: rmw_zenoh, docs/design.md; REP-2011 for the hashes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from longreach.io.bag_topics import USUAL
from longreach.io.bag_writer import type_store
from longreach.robot.description import RobotDescription

STORE = type_store(False)
TYPES: Mapping[str, Any] = STORE.types


@dataclass(frozen=True)
class Topic:
    """A name with a standard type; limit: of a payload that is looked at [bytes]."""

    name: str
    type: str
    limit: int = 4096

    @property
    def key(self) -> str:
        """The key of the messages, in ROS' domain 0."""
        return _key(self.name, self.type)

    def pack(self, message: Any) -> bytes:
        """Return a message as CDR."""
        return bytes(STORE.serialize_cdr(message, self.type))

    def unpack(self, payload: bytes) -> Any:
        """Return the message in a payload; whatever is wrong with it raises something."""
        return STORE.deserialize_cdr(payload, self.type)


@cache
def _key(name: str, type: str) -> str:
    package, _, kind = type.split("/")
    return f"0/{name.strip('/')}/{package}::msg::dds_::{kind}_/{STORE.hash_rihs01(type)}"


# What the robot says; what it senses is in `Sensed`.
ESTIMATE = Topic("/odometry/filtered", "nav_msgs/msg/Odometry")
SETTLED = Topic("/odometry/settled", "nav_msgs/msg/Odometry")
WHEELS_ALONE = Topic("/odom", "nav_msgs/msg/Odometry")
TOOL_TRUTH = Topic("/tool/truth", "geometry_msgs/msg/PoseStamped")
REFERENCE = Topic("/reference", "sensor_msgs/msg/JointState", 65536)
STATUS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", 65536)
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", 1 << 20)
TF_STATIC = Topic("/tf_static", "tf2_msgs/msg/TFMessage", 1 << 20)
PLAN = Topic("/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", 1 << 24)
URDF = Topic("/robot_description", "std_msgs/msg/String", 1 << 24)
DESCRIPTION = Topic("/longreach/description", "std_msgs/msg/String", 1 << 20)
STREAMS = (ESTIMATE, SETTLED, WHEELS_ALONE, TOOL_TRUTH, REFERENCE, STATUS, TF, TF_STATIC, PLAN)
# What clients send in a stream.
TWIST = Topic("/cmd_vel", "geometry_msgs/msg/TwistStamped")
JOINTS = Topic("/arm/command", "sensor_msgs/msg/JointState", 16384)
TOOL = Topic("/tool/goal", "geometry_msgs/msg/PoseStamped")
GRIPPER = Topic("/gripper/command", "sensor_msgs/msg/JointState")
HEARTBEAT = Topic("/longreach/heartbeat", "std_msgs/msg/Header")
COMMANDS = (TWIST, JOINTS, TOOL, GRIPPER, HEARTBEAT)
# What clients ask for, and get an answer to.
ORDER = Topic("/longreach/order", "std_msgs/msg/String")
EXECUTE = Topic("/longreach/execute", "trajectory_msgs/msg/JointTrajectory", 1 << 24)
CLOCK = Topic("/longreach/clock", "sensor_msgs/msg/TimeReference")


class Sensed(NamedTuple):
    """The topics of a robot's sensors, and of the truth where it is known, as its description names them."""

    wheels: Topic
    scans: Topic
    imu: Topic
    wrench: Topic
    arm: Topic
    truth: Topic

    @classmethod
    def of(cls, robot: RobotDescription) -> "Sensed":
        """Return those of a robot; what its description does not name has ROS' usual names."""
        topics = robot.topics
        usual = topics.wheels is None or topics.wheels == WHEELS_ALONE.name
        return cls(
            Topic("/joint_states" if usual else str(topics.wheels), "sensor_msgs/msg/JointState", 65536),
            Topic(topics.lidar or "/scan", "sensor_msgs/msg/LaserScan", 1 << 20),
            Topic(topics.imu or "/imu/data", "sensor_msgs/msg/Imu"),
            Topic(topics.wrench or USUAL["wrench"], "geometry_msgs/msg/WrenchStamped"),
            Topic(topics.joints or USUAL["joints"], "sensor_msgs/msg/JointState", 65536),
            Topic(topics.truth or "/truth", "geometry_msgs/msg/PoseStamped"),
        )
