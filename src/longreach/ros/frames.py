"""tf out and in: where frames stand in their parents, as ROS 1's tf has it."""

import math
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.geometry import se3, so3
from longreach.io import messages
from longreach.io.frames import FrameTree
from longreach.measurement import Imu, LaserScan
from longreach.robot.description import Lidar, Mount, RobotDescription
from longreach.ros import wire

TRANSFORMS = "tf2_msgs/msg/TFMessage"


class Broadcaster:
    """Sends frames on /tf."""

    def __init__(self) -> None:
        self._publisher = wire.Publisher("/tf", TRANSFORMS)

    def send(self, stamp: float, frames: Mapping[str, tuple[str, Float[np.ndarray, "4 4"]]]) -> None:
        """Send where frames stand at a time [s]: each by its name with its parent's and T_parent_frame."""
        types, sent = wire.message_types(), []
        for child, (parent, T) in frames.items():
            message = messages.transforms(types, stamp, {child: T}).transforms[0]
            message.header.frame_id = parent
            sent.append(message)
        self._publisher.send(types[TRANSFORMS](sent))


class Mounts:
    """Where a robot's sensors sit in its base, as tf says, for a description that does not."""

    def __init__(self) -> None:
        self._tree, self._lock = FrameTree(), threading.Lock()
        topics = ("/tf", "/tf_static")
        self._subscriptions = [wire.listen(topic, (TRANSFORMS,), self._take) for topic in topics]

    def described(
        self, robot: RobotDescription, scans: tuple[LaserScan, ...], imu: tuple[Imu, ...]
    ) -> RobotDescription:
        """Return the description with the mounts of the sensors that were heard, and listen no more."""
        for subscription in self._subscriptions:
            subscription.unregister()
        changes = {}
        lidar = robot.lidar or Lidar()
        with self._lock:
            for name, sensor, records in (("lidar", lidar, scans), ("imu", robot.imu, imu)):
                if sensor is None or sensor.mount is not None or not records:
                    continue
                frame = records[0].frame
                T = self._tree.mounts([frame])[0].get(frame)
                if T is not None:
                    changes[name] = sensor.model_copy(update={"mount": mount_of(T)})
        return robot.model_copy(update=changes)

    def _take(self, message: Any) -> None:
        with self._lock:
            self._tree.take(message.transforms)


def mount_of(T: Float[np.ndarray, "4 4"]) -> Mount:
    """Return a rigid motion as position and roll, pitch, yaw."""
    (x, y, z), R = T[:3, 3].tolist(), T[:3, :3]
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    if math.hypot(R[0, 0], R[1, 0]) > 1e-9:
        return Mount(x=x, y=y, z=z, roll=math.atan2(R[2, 1], R[2, 2]), pitch=pitch, yaw=math.atan2(R[1, 0], R[0, 0]))
    return Mount(x=x, y=y, z=z, pitch=pitch, yaw=math.atan2(-R[0, 1], R[1, 1]))  # upright: roll is yaw


def planar(pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return a pose [m, m, rad] in the plane as a rigid motion."""
    x, y, theta = pose.tolist()
    return se3.from_rotation_translation(so3.from_roll_pitch_yaw(0.0, 0.0, theta), np.array([x, y, 0.0]))
