"""Standard ROS messages from our records; the same for ROS 1 and ROS 2 but for the header.

`types` maps a type's name (sensor_msgs/msg/Imu) to its class, as a type store of rosbags does. Covariances that are not
known are zero there, and of what was not measured at all the first element is -1, as in sensor_msgs/Imu.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.errors import RecordingError
from longreach.geometry import so3
from longreach.measurement import Imu, JointState, LaserScan, Odometry, PoseMeasurement, Wrench

Types = Mapping[str, Any]

# Where x, y and the turn about z are in a row-major 6 x 6 covariance of x y z and the turns about them.
PLANAR = np.array([0, 1, 5, 6, 7, 11, 30, 31, 35])
NOT_MEASURED = -1.0


def nanoseconds(stamp: float) -> int:
    """Return a stamp [s] in nanoseconds, without the digits that a product with 1e9 would lose.

    Raises:
        RecordingError: ROS has no such time.
    """
    if not 0 <= stamp < 2**31:
        raise RecordingError(f"ROS cannot hold the stamp {stamp} s; stamps start at 0 and end in the year 2038.")
    seconds = math.floor(stamp)
    return seconds * 10**9 + round((stamp - seconds) * 1e9)


def header(types: Types, stamp: float, frame: str) -> Any:
    """Return a std_msgs/Header."""
    seconds, rest = divmod(nanoseconds(stamp), 10**9)
    time = types["builtin_interfaces/msg/Time"](seconds, rest)
    Header = types["std_msgs/msg/Header"]
    if "seq" in Header.__dataclass_fields__:  # ROS 1
        return Header(seq=0, stamp=time, frame_id=frame)
    return Header(stamp=time, frame_id=frame)


def joint_state(
    types: Types,
    stamp: float,
    names: Sequence[str],
    position: Float[np.ndarray, " n"] | None = None,
    velocity: Float[np.ndarray, " m"] | None = None,
    effort: Float[np.ndarray, " k"] | None = None,
) -> Any:
    """Return a sensor_msgs/JointState; what is not given stays empty."""
    given = [np.zeros(0) if values is None else np.array(values) for values in (position, velocity, effort)]
    return types["sensor_msgs/msg/JointState"](header(types, stamp, ""), list(names), *given)


def joint_state_of(types: Types, stamp: float, joints: JointState) -> Any:
    """Return a sensor_msgs/JointState."""
    return joint_state(types, stamp, joints.names, joints.position, joints.velocity, joints.effort)


def laser_scan(types: Types, stamp: float, scan: LaserScan) -> Any:
    """Return a sensor_msgs/LaserScan; ranges and angles are float32 there."""
    return types["sensor_msgs/msg/LaserScan"](
        header=header(types, stamp, scan.frame),
        angle_min=scan.angle_min,
        angle_max=scan.angle_min + scan.angle_increment * max(len(scan.ranges) - 1, 0),
        angle_increment=scan.angle_increment,
        time_increment=scan.time_increment,
        scan_time=0.0,
        range_min=scan.range_min,
        range_max=scan.range_max,
        ranges=scan.ranges.astype(np.float32),
        intensities=np.zeros(0, dtype=np.float32),
    )


def imu(types: Types, stamp: float, reading: Imu) -> Any:
    """Return a sensor_msgs/Imu without an orientation."""
    vector = types["geometry_msgs/msg/Vector3"]
    return types["sensor_msgs/msg/Imu"](
        header=header(types, stamp, reading.frame),
        orientation=_turn(types, np.array([0.0, 0.0, 0.0, 1.0])),
        orientation_covariance=_covariance_or_mark(None, False, 9),
        angular_velocity=vector(*reading.angular_velocity.tolist()),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(*(np.zeros(3) if reading.acceleration is None else reading.acceleration).tolist()),
        linear_acceleration_covariance=_covariance_or_mark(None, reading.acceleration is not None, 9),
    )


def wrench(types: Types, stamp: float, felt: Wrench) -> Any:
    """Return a geometry_msgs/WrenchStamped."""
    vector = types["geometry_msgs/msg/Vector3"]
    felt_wrench = types["geometry_msgs/msg/Wrench"](vector(*felt.force.tolist()), vector(*felt.torque.tolist()))
    return types["geometry_msgs/msg/WrenchStamped"](header(types, stamp, felt.frame), felt_wrench)


def joint_trajectory(types: Types, stamp: float, trajectory: ConfigurationTrajectory) -> Any:
    """Return a trajectory_msgs/JointTrajectory; its times count from the trajectory's first row."""
    Point, Duration = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"]
    points = []
    since = np.rint(1e9 * (trajectory.stamps - trajectory.stamps[0])).astype(int).tolist()
    for after_ns, q, v in zip(since, trajectory.q, trajectory.velocities, strict=True):
        points.append(Point(q, v, np.zeros(0), np.zeros(0), Duration(*divmod(after_ns, 10**9))))
    names = list(trajectory.joint_names) or [f"q{i}" for i in range(trajectory.q.shape[1])]
    return types["trajectory_msgs/msg/JointTrajectory"](header(types, stamp, "world"), names, points)


def odometry(types: Types, stamp: float, record: Odometry, frame: str = "odom") -> Any:
    """Return a nav_msgs/Odometry of base_link in a frame; the covariance of what the record lacks starts with -1."""
    vx, vy, omega = (np.zeros(3) if record.twist is None else record.twist).tolist()
    vector = types["geometry_msgs/msg/Vector3"]
    twist = types["geometry_msgs/msg/Twist"](vector(vx, vy, 0.0), vector(0.0, 0.0, omega))
    return types["nav_msgs/msg/Odometry"](
        header=header(types, stamp, frame),
        child_frame_id="base_link",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](
            _pose(types, np.zeros(3) if record.pose is None else record.pose),
            _covariance_or_mark(record.pose_covariance, record.pose is not None),
        ),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](
            twist, _covariance_or_mark(record.twist_covariance, record.twist is not None)
        ),
    )


def pose_stamped(types: Types, stamp: float, pose: Float[np.ndarray, "3"], *, has_heading: bool = True) -> Any:
    """Return a geometry_msgs/PoseStamped in map; without a heading its quaternion is zero."""
    message = _pose(types, pose)
    if not has_heading:
        message.orientation = _turn(types, np.zeros(4))
    return types["geometry_msgs/msg/PoseStamped"](header(types, stamp, "map"), message)


def tool_pose(types: Types, stamp: float, T: Float[np.ndarray, "4 4"]) -> Any:
    """Return a geometry_msgs/PoseStamped of a rigid motion in map."""
    point = types["geometry_msgs/msg/Point"](*T[:3, 3].tolist())
    pose = types["geometry_msgs/msg/Pose"](point, _turn(types, quaternion_xyzw(T[:3, :3])))
    return types["geometry_msgs/msg/PoseStamped"](header(types, stamp, "map"), pose)


def pose_with_covariance(types: Types, stamp: float, fix: PoseMeasurement) -> Any:
    """Return a geometry_msgs/PoseWithCovarianceStamped in map."""
    pose = types["geometry_msgs/msg/PoseWithCovariance"](
        _pose(types, fix.pose), _covariance_or_mark(fix.covariance, True)
    )
    return types["geometry_msgs/msg/PoseWithCovarianceStamped"](header(types, stamp, "map"), pose)


def base_transform(types: Types, stamp: float, pose: Float[np.ndarray, "3"]) -> Any:
    """Return a tf2_msgs/TFMessage that says where base_link is in map."""
    x, y, theta = pose.tolist()
    translation = types["geometry_msgs/msg/Vector3"](x, y, 0.0)
    transform = types["geometry_msgs/msg/Transform"](translation, _heading(types, theta))
    stamped = types["geometry_msgs/msg/TransformStamped"](header(types, stamp, "map"), "base_link", transform)
    return types["tf2_msgs/msg/TFMessage"]([stamped])


def transforms(types: Types, stamp: float, mounts: Mapping[str, Float[np.ndarray, "4 4"]]) -> Any:
    """Return a tf2_msgs/TFMessage that says where the frames are in base_link."""
    stamped = []
    for frame, T in mounts.items():
        translation = types["geometry_msgs/msg/Vector3"](*T[:3, 3].tolist())
        transform = types["geometry_msgs/msg/Transform"](translation, _turn(types, quaternion_xyzw(T[:3, :3])))
        stamped.append(types["geometry_msgs/msg/TransformStamped"](header(types, stamp, "base_link"), frame, transform))
    return types["tf2_msgs/msg/TFMessage"](stamped)


def quaternion_xyzw(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4"]:
    """Return the quaternion of a rotation, its real part not negative."""
    w = so3.log(R)
    angle = float(np.linalg.norm(w))
    axis = w / angle if angle > 0 else np.zeros(3)
    return np.append(np.sin(angle / 2) * axis, np.cos(angle / 2))


def rotation_matrix(xyzw: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of a quaternion, which need not be of unit length; of a zero one the identity."""
    size = np.linalg.norm(xyzw)
    x, y, z, w = xyzw / size if size > 0 else np.array([0.0, 0.0, 0.0, 1.0])
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _turn(types: Types, xyzw: np.ndarray) -> Any:
    return types["geometry_msgs/msg/Quaternion"](*xyzw.tolist())


def _heading(types: Types, theta: float) -> Any:
    return _turn(types, np.array([0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2)]))


def _pose(types: Types, pose: np.ndarray) -> Any:
    x, y, theta = pose.tolist()
    return types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](x, y, 0.0), _heading(types, theta))


def _covariance_or_mark(planar: np.ndarray | None, measured: bool, size: int = 36) -> np.ndarray:
    values = np.zeros(size)
    if not measured:
        values[0] = NOT_MEASURED
    elif planar is not None:
        values[PLANAR] = planar.reshape(-1)
    return values
