"""tf out: where frames stand in their parents, as ROS 1's tf has it."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from longreach.geometry import se3, so3
from longreach.io import messages
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


def planar(pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return a pose [m, m, rad] in the plane as a rigid motion."""
    x, y, theta = pose.tolist()
    return se3.from_rotation_translation(so3.from_roll_pitch_yaw(0.0, 0.0, theta), np.array([x, y, 0.0]))
