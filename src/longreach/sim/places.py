"""Where in MuJoCo's arrays a robot's parts are."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.errors import ConfigError
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.mujoco_model import WRENCH_LINK

_SPREAD = "joint_0"  # ends the names of the fingers' joints that do not close them


@dataclass(frozen=True, eq=False)
class Hand:
    """The fingers' joints: their angles when closed (k,) [rad], and what each one's angle says of how far they are."""

    names: tuple[str, ...]
    closed: Float[np.ndarray, " k"]
    share: Float[np.ndarray, " k"]

    @classmethod
    def of(cls, robot: MobileManipulator) -> "Hand":
        """Return all joints of a robot's URDF that are neither wheels nor the arm's."""
        wheels = robot.description.base.wheel_names if robot.description.base else ()
        beside = {*wheels, *robot.joint_names[robot.arm]}
        joints = [j for j in (robot.urdf.joints if robot.urdf else ()) if j.driven and j.name not in beside]
        ends = [0.0 if j.name.endswith(_SPREAD) else j.limits.upper for j in joints]
        closed = np.array([end if np.isfinite(end) else 0.0 for end in ends])
        moving = max(np.count_nonzero(closed), 1)
        share = np.array([1.0 / (moving * angle) if angle > 0 else 0.0 for angle in closed.tolist()])
        return cls(tuple(j.name for j in joints), closed, share)


class Places:
    """Rows of qpos, qvel, sensordata and ctrl for wheels, joints (arm, then fingers) and sensors; bodies by number."""

    def __init__(self, robot: MobileManipulator, model: Any) -> None:
        base, urdf = robot.description.base, robot.urdf
        if base is None or urdf is None:
            raise ConfigError(f"{robot.name} has no wheels or no URDF.")
        self.wheel_names, self.arm_names = base.wheel_names, robot.joint_names[robot.arm]
        hand = Hand.of(robot)
        self.finger_names, self.closed, self.share = hand.names, hand.closed, hand.share
        self.joint_names = (*self.arm_names, *self.finger_names)
        self.wheels, self.wheel_speeds, self.wheel_motors = _rows(model, self.wheel_names)
        self.joints, self.joint_speeds, motors = _rows(model, self.joint_names)
        n = len(self.arm_names)
        self.arm, self.arm_motors, self.finger_motors = self.joints[:n], motors[:n], motors[n:]
        self.gyro, self.force = sensed(model, "gyro"), sensed(model, "accelerometer")
        self.efforts = np.array([model.sensor(f"{name}_effort").adr[0] for name in self.joint_names], dtype=int)
        joints = {joint.name: joint for joint in urdf.joints}
        last = joints[self.arm_names[-1]].child if n else urdf.root
        self.root, self.last = int(model.body(urdf.root).id), int(model.body(last).id)
        self.last_frame = slice(sensed(model, "last_pos").start, sensed(model, "last_yaxis").stop)
        self.T_last_tool = robot.chain.relative(last, robot.tool)


def _rows(model: Any, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    joints = [model.joint(name) for name in names]
    qpos, qvel = [int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints]
    motors = [int(model.actuator(name).id) for name in names]
    return np.array(qpos, dtype=int), np.array(qvel, dtype=int), np.array(motors, dtype=int)


def sensed(model: Any, name: str) -> slice:
    """Return where the numbers of one of the model's sensors are."""
    known = model.sensor(name)
    return slice(int(known.adr[0]), int(known.adr[0] + known.dim[0]))


@dataclass(frozen=True, eq=False)
class Load:
    """What hangs on the force-torque sensor: its mass [kg] and its centre (3,) [m] in the sensor's frame.

    held: rows of force and torque in what is sensed; up: rows of the world's z in the sensor's frame.
    """

    mass: float
    centre: Float[np.ndarray, "3"]
    held: slice
    up: slice


def load_of(robot: MobileManipulator, model: Any, data: Any) -> Load | None:
    """Return what hangs on the robot's force-torque sensor as it now stands; None where it has no such sensor."""
    if robot.urdf is None or WRENCH_LINK not in robot.urdf.links:
        return None
    body = model.body(WRENCH_LINK).id
    R, p = data.xmat[body].reshape(3, 3), data.xpos[body]
    force, torque = sensed(model, "force"), sensed(model, "torque")
    held = slice(force.start, torque.stop)
    mass = float(model.body_subtreemass[body])
    return Load(mass, R.T @ (data.subtree_com[body] - p), held, sensed(model, "up"))
