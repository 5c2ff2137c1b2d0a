"""Commands that come in on ROS topics for a robot's base and arm, the newest of each, each handed out once."""

import threading
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.control.hardware import ArmMode
from longreach.ros import wire

TWIST, NUMBERS, BOOL = "geometry_msgs/msg/Twist", "std_msgs/msg/Float64MultiArray", "std_msgs/msg/Bool"
ARM_TOPICS: dict[ArmMode, str] = {
    "velocity": "/arm_velocity_controller/command",
    "position": "/arm_position_controller/command",
}
EMERGENCY_STOP = "/emergency_stop"


class Commands:
    """A node's subscriptions to commands: a body twist, the arm's velocities or positions, and the stop.

    stop_pressed: whether /emergency_stop said true last.
    """

    def __init__(self, base: str, joints: int) -> None:
        self._lock, self._joints = threading.Lock(), joints
        self._base: np.ndarray | None = None
        self._arm: tuple[ArmMode, np.ndarray] | None = None
        self.stop_pressed = False
        wire.listen(base, (TWIST,), self._take_base)
        for mode, topic in ARM_TOPICS.items():
            wire.listen(topic, (NUMBERS,), lambda message, mode=mode: self._take_arm(mode, message))
        wire.listen(EMERGENCY_STOP, (BOOL,), self._take_stop)

    def take(self) -> tuple[Float[np.ndarray, "3"] | None, tuple[ArmMode, Float[np.ndarray, " n"]] | None]:
        """Return the twist (3,) and the arm's mode and numbers (n,) that came in since the last call."""
        with self._lock:
            new = self._base, self._arm
            self._base = self._arm = None
        return new

    def _take_base(self, message: Any) -> None:
        with self._lock:
            self._base = np.array([message.linear.x, message.linear.y, message.angular.z])

    def _take_arm(self, mode: ArmMode, message: Any) -> None:
        if len(message.data) != self._joints:
            wire.complain(f"A command of {len(message.data)} numbers cannot move {self._joints} joints.")
            return
        with self._lock:
            self._arm = mode, np.array(message.data, dtype=float)

    def _take_stop(self, message: Any) -> None:
        self.stop_pressed = bool(message.data)
