"""ROS 1 in tests: processes, waiting, and a recording that is played in."""

import os
import signal
import socket
import subprocess
import time
from contextlib import contextmanager
from importlib import import_module

import numpy as np

from longreach.control.hardware import Readings
from longreach.io import messages
from longreach.io.messages import PLANAR
from longreach.io.records import planar_pose
from longreach.ros import wire
from longreach.ros.estimate import Estimator
from longreach.ros.sensors import Heard


def free_port():
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        return listening.getsockname()[1]


def until(condition, seconds=10.0, what="it"):
    """Wait until a condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"{what} did not come in {seconds:g} s"
        time.sleep(0.01)


@contextmanager
def process(arguments, environment, log=None):
    """A program that runs while the test does, and is interrupted then; it must end by itself. log: of its errors."""
    shown = {"stdout": subprocess.DEVNULL, "stderr": log or subprocess.DEVNULL}
    started = subprocess.Popen([str(argument) for argument in arguments], env=environment, **shown)
    try:
        yield started
    finally:
        started.send_signal(signal.SIGINT)
        try:
            started.wait(timeout=15.0)
        except subprocess.TimeoutExpired:
            started.kill()
            started.wait()


def this_node(environment):
    """Make this process a node of the ROS that the environment names."""
    os.environ.update(environment)
    wire.start_node("tests")


def can_import(module):
    """Whether this process can import a module."""
    try:
        import_module(module)
    except ImportError:
        return False
    return True


def parameter(name, value):
    """Set a parameter of ROS."""
    wire.rospy().set_param(name, value)


@contextmanager
def listening(topic, kind):
    """What comes in on a topic, a list that grows, and what waits for somebody to send there."""
    heard = []
    subscription = wire.listen(topic, (kind,), heard.append, heard.append)
    try:
        yield heard, lambda: until(subscription.get_num_connections, 20.0, f"who sends {topic}")
    finally:
        subscription.unregister()


def wheels_message(robot, types, stamp, record):
    """What the Ridgeback's driver says of its wheels."""
    return messages.joint_state(types, stamp, robot.base.wheel_names, position=record.ticks)


def play(robot, recording, speed, ready):
    """Send a recording's messages at their times, faster by a factor, as soon as all listen and it is ready."""
    types = wire.message_types()
    static = wire.Publisher("/tf_static", "tf2_msgs/msg/TFMessage", latch=True)
    static.send(messages.transforms(types, recording.wheels[0].stamp, recording.mounts))
    kinds = {
        "wheels": ("/joint_states", "sensor_msgs/msg/JointState", lambda *args: wheels_message(robot, *args)),
        "scans": ("/front/scan", "sensor_msgs/msg/LaserScan", messages.laser_scan),
        "imu": ("/imu/data", "sensor_msgs/msg/Imu", messages.imu),
        "fixes": ("/fixes", "geometry_msgs/msg/PoseWithCovarianceStamped", messages.pose_with_covariance),
    }
    kinds = {kind: way for kind, way in kinds.items() if getattr(recording, kind)}
    publishers = {kind: wire.Publisher(topic, type) for kind, (topic, type, _) in kinds.items()}
    until(lambda: all(publisher.listeners for publisher in publishers.values()), 20.0, "the node")
    ready()
    rows = sorted(
        ((record.stamp, kind, record) for kind in kinds for record in getattr(recording, kind)), key=lambda row: row[0]
    )
    start, began = rows[0][0], time.monotonic()
    for stamp, kind, record in rows:
        time.sleep(max((stamp - start) / speed - (time.monotonic() - began), 0.0))
        publishers[kind].send(kinds[kind][2](types, stamp, record))


def played(robot, recording, speed, topic, rest=1.0):
    """Play a recording, and return what odometry comes out on a topic: stamp → pose (3,) and covariance (3, 3)."""
    with listening(topic, "nav_msgs/msg/Odometry") as (heard, ready):
        play(robot, recording, speed, ready)
        time.sleep(rest)
    return odometry(heard)


def odometry(messages):
    """What odometry says: stamp → pose (3,) and covariance (3, 3)."""
    return {
        (message.header.stamp.sec * 10**9 + message.header.stamp.nanosec) / 10**9: (
            planar_pose(message.pose.pose.position, message.pose.pose.orientation),
            np.array(message.pose.covariance)[PLANAR].reshape(3, 3),
        )
        for message in messages
    }


def portions(recording, late, tick):
    """What is heard tick by tick, each kind so much late [s], and when."""
    left = {kind: list(getattr(recording, kind)) for kind in late}
    now = 0.0
    while any(left.values()):
        now += tick
        new = {}
        for kind, records in left.items():
            count = sum(record.stamp + late[kind] <= now for record in records)
            new[kind], left[kind] = tuple(records[:count]), records[count:]
        fixes = new.pop("fixes", ())
        yield Heard(Readings(now, **new), fixes), now


def rows_heard(robot, config, recording, late, tick):
    """The rows that settle, by stamp."""
    estimator = Estimator(robot, config)
    heard = portions(recording, late, tick)
    return {row.stamp: row for portion, now in heard for row in estimator.take(portion, now).rows}
