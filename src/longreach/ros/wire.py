"""ROS 1 topics through rospy, their messages packed and unpacked by rosbags: the very types and readers of our bags.

rospy carries bytes here and nothing else, so that it is all of ROS that must be there: no message package is.
It is Debian's or ROS' own, and is found where Python finds it (PYTHONPATH, as ROS' setup.bash sets it), or else among
Debian's packages, whose folder is then put last, behind all that this environment has of its own.
"""

import atexit
import logging
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from longreach.errors import LiveError, LongreachError
from longreach.io.messages import Types

_LOG = logging.getLogger("longreach.ros")
_DEBIAN = Path("/usr/lib/python3/dist-packages")
_QUEUE = 1000  # messages that wait for a slow listener; a scan takes 4 kB
_FAREWELL = 0.05  # [s] for the last messages to leave

# control_msgs and actionlib's part of it, which Debian has not: the fields as their packages name them.
_GRIPPED = "float64 position\nfloat64 effort\nbool stalled\nbool reached_goal"
_ACTION = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "control_msgs/msg/JointTolerance": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration",
    "control_msgs/msg/FollowJointTrajectoryGoal": (
        "trajectory_msgs/JointTrajectory trajectory\nJointTolerance[] path_tolerance\n"
        "JointTolerance[] goal_tolerance\nduration goal_time_tolerance"
    ),
    "control_msgs/msg/FollowJointTrajectoryResult": (
        "int32 error_code\nint32 SUCCESSFUL = 0\nint32 INVALID_GOAL = -1\nint32 INVALID_JOINTS = -2\n"
        "int32 OLD_HEADER_TIMESTAMP = -3\nint32 PATH_TOLERANCE_VIOLATED = -4\n"
        "int32 GOAL_TOLERANCE_VIOLATED = -5\nstring error_string"
    ),
    "control_msgs/msg/FollowJointTrajectoryFeedback": (
        "Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint desired\n"
        "trajectory_msgs/JointTrajectoryPoint actual\ntrajectory_msgs/JointTrajectoryPoint error"
    ),
    "control_msgs/msg/FollowJointTrajectoryActionGoal": (
        "Header header\nactionlib_msgs/GoalID goal_id\nFollowJointTrajectoryGoal goal"
    ),
    "control_msgs/msg/FollowJointTrajectoryActionResult": (
        "Header header\nactionlib_msgs/GoalStatus status\nFollowJointTrajectoryResult result"
    ),
    "control_msgs/msg/FollowJointTrajectoryActionFeedback": (
        "Header header\nactionlib_msgs/GoalStatus status\nFollowJointTrajectoryFeedback feedback"
    ),
    "control_msgs/msg/GripperCommand": "float64 position\nfloat64 max_effort",
    "control_msgs/msg/GripperCommandGoal": "GripperCommand command",
    "control_msgs/msg/GripperCommandResult": _GRIPPED,
    "control_msgs/msg/GripperCommandFeedback": _GRIPPED,
    "control_msgs/msg/GripperCommandActionGoal": (
        "Header header\nactionlib_msgs/GoalID goal_id\nGripperCommandGoal goal"
    ),
    "control_msgs/msg/GripperCommandActionResult": (
        "Header header\nactionlib_msgs/GoalStatus status\nGripperCommandResult result"
    ),
    "control_msgs/msg/GripperCommandActionFeedback": (
        "Header header\nactionlib_msgs/GoalStatus status\nGripperCommandFeedback feedback"
    ),
}


@cache
def store() -> Any:
    """Return the types of ROS 1 messages, those of the actions of arm and gripper among them."""
    types = get_typestore(Stores.ROS1_NOETIC)
    for name, definition in _ACTION.items():
        types.register(get_types_from_msg(definition, name))
    return types


def message_types() -> Types:
    """Return a message's class by its type's name, as `longreach.io.messages` takes them."""
    return store().types


@cache
def rospy() -> Any:
    """Return rospy.

    Raises:
        LiveError: it is not there.
    """
    if find_spec("rospy") is None and (_DEBIAN / "rospy").is_dir():
        sys.path.append(str(_DEBIAN))
    try:
        return import_module("rospy")
    except ImportError as error:
        raise LiveError(
            f"ROS 1 cannot be used here ({error}): install Debian's python3-rospy, or source the setup.bash of a ROS "
            "whose Python is this one."
        ) from error


def start_node(name: str, wait: float = 10.0) -> None:
    """Become a node, unless this process is one already; what roslaunch calls it goes before.

    wait: for how long a master is waited for [s]. Interrupts are not rospy's: see `running`.

    Raises:
        LiveError: no ROS master answers.
    """
    ros, graph = rospy(), import_module("rosgraph")
    if ros.core.is_initialized():
        return
    master, until = graph.get_master_uri(), time.monotonic() + wait
    _LOG.info("Waiting for the ROS master at %s, for %g s at most.", master, wait)
    while not graph.is_master_online():
        if time.monotonic() > until:
            raise LiveError(f"No ROS master answers at {master}; start roscore there.")
        time.sleep(0.1)
    ros.init_node(name, disable_signals=True)
    _LOG.info("The ROS master has answered; this is the node %s.", ros.get_name())


@contextmanager
def running() -> Iterator[Callable[[], bool]]:
    """Yield whether the node goes on, which ends with an interrupt, and end it then.

    rospy's own handlers shut down at once, whatever is going on, and wait forever for a lock that a message on its way
    out holds.
    """
    ended = threading.Event()
    ends = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: ended.set()) for number in ends]
    try:
        yield lambda: not (ended.is_set() or rospy().is_shutdown())
    finally:
        rospy().signal_shutdown("The node has ended.")
        for number, handler in zip(ends, before, strict=True):
            signal.signal(number, handler)


def before_the_end(call: Callable[[], None]) -> None:
    """Call something while messages still leave, when this process ends in whatever orderly way."""

    def farewell() -> None:
        call()
        time.sleep(_FAREWELL)

    atexit.register(farewell)  # goes before rospy's own


def now() -> float:
    """Return the time of ROS [s]."""
    return float(rospy().get_time())


class Publisher:
    """A topic of one type to send messages on; to a latched one a late listener still gets the last message."""

    def __init__(self, topic: str, kind: str, *, latch: bool = False) -> None:
        self.topic, self._kind, self._class = topic, kind, _packed(kind)
        self._publisher = rospy().Publisher(topic, self._class, latch=latch, queue_size=_QUEUE)

    @property
    def listeners(self) -> int:
        """How many listen."""
        return int(self._publisher.get_num_connections())

    def send(self, message: Any) -> None:
        """Send a message of `message_types`; after the node has ended this does nothing."""
        packed = self._class()
        packed.data = store().serialize_ros1(message, self._kind)
        if not rospy().is_shutdown():
            with suppress(rospy().ROSException):  # closed meanwhile
                self._publisher.publish(packed)


def listen(
    topic: str, kinds: tuple[str, ...], take: Callable[[Any], None], refuse: Callable[[str], None] | None = None
) -> Any:
    """Call `take` with each message on a topic, from rospy's thread, or `refuse` with why it cannot be used.

    That is the end of a sentence that starts with "it"; where nobody takes it, it goes to the node's log.
    """

    def say(why: str) -> None:
        complain(f"A message on {topic} {why}.") if refuse is None else refuse(why)

    def unpack(packed: Any) -> None:
        kind = packed._connection_header["type"].replace("/", "/msg/")
        if kind not in kinds:
            return say(f"is of type {kind}, but {' or '.join(kinds)} is read")
        try:
            take(store().deserialize_ros1(_bytes(packed), kind))
        except (LongreachError, SerdeError) as error:
            say(f"cannot be read: {str(error).rstrip('.')}")

    return rospy().Subscriber(topic, rospy().AnyMsg, unpack, queue_size=_QUEUE, tcp_nodelay=True)


def complain(sentence: str) -> None:
    """Say on the node's log what is wrong with what others send, no more than once a second."""
    rospy().logwarn_throttle(1.0, sentence)


def _bytes(message: Any) -> bytes:
    """Return a message packed; where others in this process listen to its topic as well, rospy has unpacked it."""
    if hasattr(message, "_buff"):
        return message._buff
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


@cache
def _packed(kind: str) -> Any:
    """Return a class of rospy's messages that holds packed bytes of a type."""
    definition, md5 = store().generate_msgdef(kind, ros_version=1)
    members = {
        "_type": kind.replace("/msg/", "/"),
        "_md5sum": md5,
        "_full_text": definition,
        "_has_header": False,
        "_slot_types": ["uint8[]"],
        "__slots__": ["data"],
        "serialize": lambda self, buffer: buffer.write(self.data),
    }
    return type("Packed", (import_module("genpy").Message,), members)
