"""What a robot says of itself, tick by tick."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class LiveState:
    """The newest of everything at one tick of the robot's loop; `stamp` [s] is on the robot's clock.

    q (n,): base first, in map: where the robot thinks it is [m, m, rad, rad …]; q[:3] is the pose of the estimate.
    velocity (n,): its body twist [v_x, v_y, ω], then the arm's joints [rad/s].
    covariance (3, 3): of the error ξ of the base's pose, in its own frame.
    wheels (3,): where the wheels alone say it is (the frame odom is placed by it: map → odom → base_link).
    truth (3,), tool_truth (4, 4): where base and tool really are, where that is known, else None.
    joints: all that move, fingers included, by their names [rad].
    reference (n,): where the plan is now; q where no plan runs.
    progress: how much of the plan is done, 0 to 1; plan: its number. goal: what it does: hold, velocity, servo, follow.
    loop_time [s]: what the last tick computed. stop: why the safety gate stops the robot, empty where it does not;
    latched: whether it stays so until `reset`. cause: the kind of stop, as in docs/driving.md; stopped_at [s]: since
    when; stopped_by: which client has stopped it, empty where none did.
    holder: the name of the client that commands it, empty where none does. refused: how many messages the robot has
    refused so far, whoever sent them. why: why the last goal has ended early. limited: what the laser sees that slows
    the base down. minds_obstacles: whether it is slowed down at all. remarks: what is wrong with the robot's readings,
    a sentence each.
    """

    stamp: float
    q: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "3 3"]
    wheels: Float[np.ndarray, "3"]
    truth: Float[np.ndarray, "3"] | None
    tool_truth: Float[np.ndarray, "4 4"] | None
    joints: Mapping[str, float]
    reference: Float[np.ndarray, " n"]
    progress: float = 0.0
    plan: int = 0
    goal: str = "hold"
    loop_time: float = 0.0
    stop: str = ""
    latched: bool = False
    cause: str = ""
    stopped_by: str = ""
    stopped_at: float = 0.0
    holder: str = ""
    refused: int = 0
    why: str = ""
    limited: str = ""
    minds_obstacles: bool = False
    remarks: tuple[str, ...] = ()
