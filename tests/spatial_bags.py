"""Small bags with what a robot_localization node hears, from a robot that drives a curve with a tilted IMU."""

import numpy as np

from longreach.geometry import se3, so3
from longreach.io import messages
from longreach.io.bag_writer import new_bag

MOUNT = "base_link:imu_link=0.1,-0.3,0.5,1.5707963,0,-1.5707963"
U = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.3])
COUNT, DT, START = 60, 0.05, 1000.0
PARAMETERS = """
ekf_node:
  ros__parameters:
    frequency: 20.0
    sensor_timeout: 0.2
    odom0: /odom
    odom0_config: [false, false, false, false, false, false, true, true, true, false, false, false, false, false, false]
    imu0: imu/data
    imu0_config: [false, false, false, true, true, true, false, false, false, true, true, true, false, false, false]
    publish_tf: true
"""


def truth():
    """T_world_base (COUNT, 4, 4)."""
    return np.array([se3.exp(U * DT * i) for i in range(COUNT)])


def quaternion(R):
    w = so3.log(R)
    angle = np.linalg.norm(w)
    return *(0.5 * np.sinc(angle / (2 * np.pi)) * w), np.cos(0.5 * angle)


def vector(types, v):
    return types["geometry_msgs/msg/Vector3"](*map(float, v))


def pose(types, T, variance=1e-4):
    place = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](*map(float, T[:3, 3])),
        types["geometry_msgs/msg/Quaternion"](*map(float, quaternion(T[:3, :3]))),
    )
    return types["geometry_msgs/msg/PoseWithCovariance"](place, (variance * np.eye(6)).ravel())


def twist(types, u, variance=1e-4):
    told = types["geometry_msgs/msg/Twist"](vector(types, u[:3]), vector(types, u[3:]))
    return types["geometry_msgs/msg/TwistWithCovariance"](told, (variance * np.eye(6)).ravel())


def odometry(types, stamp, T, u, child="base_link"):
    head = messages.header(types, stamp, "odom")
    return types["nav_msgs/msg/Odometry"](head, child, pose(types, T), twist(types, u))


def imu(types, stamp, T, u, mount, known=True):
    head, sigma = messages.header(types, stamp, "imu_link"), (1e-4 * np.eye(3)).ravel()
    R = T[:3, :3] @ mount[:3, :3]
    turn = types["geometry_msgs/msg/Quaternion"](*map(float, quaternion(R)))
    rates, force = vector(types, mount[:3, :3].T @ u[3:]), vector(types, R.T @ [0.0, 0.0, 9.80665])
    first = sigma if known else np.array([-1.0, *sigma[1:]])
    return types["sensor_msgs/msg/Imu"](head, turn, first, rates, sigma, force, sigma)


def mount():
    numbers = [float(v) for v in MOUNT.partition("=")[2].split(",")]
    return se3.from_rotation_translation(so3.from_roll_pitch_yaw(*numbers[3:]), np.array(numbers[:3]))


def write(path, late=None, more=None, **options):
    """Write a bag; `late` (2 COUNT,) [s] delays messages, `more` writes others."""
    late = np.zeros(2 * COUNT) if late is None else late
    with new_bag(path) as bag:
        sent = []
        for i, T in enumerate(truth()):
            t = START + DT * i
            sent.append((t + late[2 * i], "/odom", odometry(bag.types, t, T, U)))
            sent.append((t + 0.01 + late[2 * i + 1], "/imu/data", imu(bag.types, t, T, U, mount(), **options)))
        for received, topic, message in sorted(sent, key=lambda each: each[0]):
            bag.write(topic, message, received)
        if more is not None:
            more(bag)
