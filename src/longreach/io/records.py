"""Our records from standard ROS messages.

A function here takes a message and returns what makes the record once its stamp is known; or why the message cannot be
used, as the end of a sentence that starts with "it"; or None where it is about something else.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2, se3
from longreach.io.messages import NOT_MEASURED, PLANAR, rotation_matrix
from longreach.measurement import Imu, JointState, LaserScan, Odometry, PoseMeasurement, WheelSpeeds, WheelTicks, Wrench
from longreach.robot.description import Encoder, Lidar, RobotDescription

Make = Callable[..., Any]
Read = Make | str
GYRO_NOT_FINITE = "has an angular velocity that is not finite"

# Of a fix whose message says none; ours. A motion capture is better, but where its markers sit is known to about this.
FIX_DEVIATIONS = (0.01, 0.01, 0.01)  # [m, m, rad]


def frame_name(name: str) -> str:
    """Return a frame without the slash that old ROS puts first."""
    return name.lstrip("/")


def left_out(count: int, topic: str, why: str) -> str:
    """Return the sentence about messages of a topic that a function here could not use."""
    return f"{count} messages of {topic} cannot be used and were left out: each {why}."


def laser_scan(message: Any, lidar: Lidar | None) -> Read:
    """Read a sensor_msgs/LaserScan; where it leaves its angles or ranges at 0, those of the description stand in."""
    lidar = lidar or Lidar()
    angle_min, increment = message.angle_min, message.angle_increment
    if not increment and lidar.angle_increment is not None and lidar.angle_min is not None:
        angle_min, increment = lidar.angle_min, lidar.angle_increment
    if not (math.isfinite(angle_min) and math.isfinite(increment)):
        return f"has the angle_min {angle_min:g} and the angle_increment {increment:g}"
    if not increment or not len(message.ranges):
        return "has no ranges" if increment else "has the angle_increment 0"
    range_min, range_max = (one if math.isfinite(one) else 0.0 for one in (message.range_min, message.range_max))
    return partial(
        LaserScan,
        ranges=message.ranges,
        angle_min=float(angle_min),
        angle_increment=float(increment),
        range_min=float(range_min or lidar.range_min or 0.0),
        range_max=float((range_max > range_min and range_max) or lidar.range_max or math.inf),
        time_increment=float(message.time_increment if math.isfinite(message.time_increment) else 0.0),
        frame=frame_name(message.header.frame_id) or lidar.frame or "laser",
    )


def imu(message: Any) -> Read:
    """Read a sensor_msgs/Imu; an acceleration that is marked as not measured, or not finite, is None."""
    w, a = message.angular_velocity, message.linear_acceleration
    if message.angular_velocity_covariance[0] == NOT_MEASURED:
        return "marks its angular velocity as not measured"
    if not math.isfinite(w.x + w.y + w.z):
        return GYRO_NOT_FINITE
    felt = message.linear_acceleration_covariance[0] != NOT_MEASURED and math.isfinite(a.x + a.y + a.z)
    return partial(
        Imu,
        angular_velocity=np.array([w.x, w.y, w.z]),
        acceleration=np.array([a.x, a.y, a.z]) if felt else None,
        frame=frame_name(message.header.frame_id) or "imu",
    )


def wrench(message: Any) -> Read:
    """Read a geometry_msgs/WrenchStamped."""
    f, t = message.wrench.force, message.wrench.torque
    if not math.isfinite(f.x + f.y + f.z + t.x + t.y + t.z):
        return "is not finite"
    frame = frame_name(message.header.frame_id) or "wrench"
    return partial(Wrench, force=np.array([f.x, f.y, f.z]), torque=np.array([t.x, t.y, t.z]), frame=frame)


def odometry(message: Any, T_base_child: Float[np.ndarray, "4 4"] | None = None) -> Read:
    """Read a nav_msgs/Odometry; a pose or twist whose covariance starts with -1 was not measured.

    T_base_child: where the frame that it speaks of is mounted in the base, None: it is the base. Then the base's own
    motion is returned; its covariance is not known.
    """
    pose, twist = None, None
    if message.pose.covariance[0] != NOT_MEASURED:
        given = message.pose.pose
        if T_base_child is None:
            pose = _with_heading(planar_pose(given.position, given.orientation))
        else:
            pose = _of_base(given, T_base_child)
    if message.twist.covariance[0] != NOT_MEASURED:
        v, w = message.twist.twist.linear, message.twist.twist.angular
        spatial = np.array([v.x, v.y, v.z, w.x, w.y, w.z])
        if T_base_child is not None:
            spatial = se3.adjoint(T_base_child) @ spatial
        twist = spatial[[0, 1, 5]] if math.isfinite(spatial.sum()) else None
    if pose is None and twist is None:
        return "has neither a pose nor a twist that is measured and finite"
    known = T_base_child is None
    return partial(
        Odometry,
        pose=pose,
        twist=twist,
        pose_covariance=_known(message.pose.covariance) if known and pose is not None else None,
        twist_covariance=_known(message.twist.covariance) if known and twist is not None else None,
    )


def _of_base(pose: Any, T_base_child: np.ndarray) -> np.ndarray | None:
    """Return the planar pose of the base, in the frame where it began at the child's pose carried along."""
    p, q = pose.position, pose.orientation
    position, xyzw = np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w])
    if not (np.isfinite(position).all() and np.isfinite(xyzw).all() and np.abs(xyzw).max() > 1e-6):
        return None
    T = se3.from_rotation_translation(rotation_matrix(xyzw), position)
    return se2.from_se3(T_base_child @ T @ se3.inverse(T_base_child))


def wheels(message: Any, robot: RobotDescription) -> tuple[bool, Make] | str | None:
    """Read the wheels out of a sensor_msgs/JointState: whether they were found by name, and what makes the record.

    Where the names are others, or none, but there are as many numbers as wheels, they are taken in their order.
    """
    assert robot.base is not None
    names, signal = robot.base.wheel_names, (robot.encoder or Encoder()).signal
    values = message.velocity if signal == "speed" else message.position
    make = partial(WheelSpeeds) if signal == "speed" else partial(WheelTicks)
    key = "speeds" if signal == "speed" else "ticks"
    steered = robot.base.kind == "ackermann"  # its last number is always a position
    if set(names) <= set(message.name) and len(values) != len(message.name):
        what = "velocities" if signal == "speed" else "positions"
        return f"names {len(message.name)} joints but has {len(values)} {what}"
    if set(names) <= set(message.name):
        where = [message.name.index(name) for name in names]
        values = values[where]
        if steered:
            if len(message.position) != len(message.name):
                return None
            values[-1] = message.position[where[-1]]
        return True, partial(make, **{key: values})
    if len(values) == len(names) and not steered:
        return False, partial(make, **{key: values})
    return None


def joints(message: Any, robot: RobotDescription) -> Make | None:
    """Read a sensor_msgs/JointState without the robot's wheels."""
    wheel_names = robot.base.wheel_names if robot.base is not None else ()
    keep = [i for i, name in enumerate(message.name) if name not in wheel_names]
    if not keep:
        return None
    given = {
        what: values[keep] if len(values) == len(message.name) else np.zeros(0)
        for what in ("position", "velocity", "effort")
        for values in (getattr(message, what),)
    }
    return partial(JointState, names=tuple(message.name[i] for i in keep), **given)


def stamped_pose(message: Any) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"] | None] | None:
    """Read pose and covariance of any message with one stamped pose; its heading is NaN where it has none."""
    if message.__msgtype__ == "geometry_msgs/msg/TransformStamped":
        return _paired(planar_pose(message.transform.translation, message.transform.rotation), None)
    pose, covariance = message.pose, None
    if message.__msgtype__ != "geometry_msgs/msg/PoseStamped":
        if pose.covariance[0] == NOT_MEASURED:
            return None
        pose, covariance = pose.pose, _known(pose.covariance)
    return _paired(planar_pose(pose.position, pose.orientation), covariance)


def fix(message: Any) -> tuple[bool, Make] | None:
    """Read an absolute pose: whether it says how good it is, and what makes the record.

    Otherwise it is taken to be good to FIX_DEVIATIONS. Without a heading its variance is infinite.
    """
    found = stamped_pose(message)
    if found is None:
        return None
    pose, covariance = found
    known = covariance is not None
    if covariance is None:
        covariance = np.diag(np.square(FIX_DEVIATIONS))
    if math.isnan(pose[2]):
        pose[2] = 0.0
        covariance[2, :] = covariance[:, 2] = 0.0
        covariance[2, 2] = math.inf
    return known, partial(PoseMeasurement, pose=pose, covariance=covariance)


def planar_pose(position: Any, q: Any) -> Float[np.ndarray, "3"] | None:
    """Return x, y [m] and the turn about z [rad], which is NaN where the quaternion is zero."""
    size = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z
    if not math.isfinite(size + position.x + position.y):
        return None
    if size < 1e-12:
        return np.array([position.x, position.y, math.nan])
    # The quaternion need not be of unit length.
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z)
    return np.array([position.x, position.y, yaw])


def _paired(pose: np.ndarray | None, covariance: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None] | None:
    return None if pose is None else (pose, covariance)


def _with_heading(pose: np.ndarray | None) -> np.ndarray | None:
    return None if pose is None or math.isnan(pose[2]) else pose


def _known(covariance: np.ndarray) -> np.ndarray | None:
    """Return the covariance (3, 3) of x, y and the turn about z, or None where it is left at zero or nonsense."""
    planar = covariance[PLANAR]
    total = float(planar.sum())  # NaN if any is
    x, y, theta = planar[::4].tolist()
    known = max(x, y, theta) > 0 and min(x, y, theta) >= 0 and not math.isnan(total)
    return planar.reshape(3, 3) if known else None
