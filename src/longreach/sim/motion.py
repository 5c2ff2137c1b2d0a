"""How a simulated robot moves: the model in MuJoCo, its drivers, and the last steps as a memory for its sensors."""

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.errors import ConfigError
from longreach.geometry import se2
from longreach.robot.bases import MecanumBase
from longreach.robot.chain import JointLimits
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.drivers import ArmDriver, BaseDriver, GripperDriver
from longreach.sim.mujoco_model import STEP, compiled, engine, mjcf, set_gains
from longreach.sim.places import Places
from longreach.sim.worlds import World

PAST = 64  # steps that are remembered: more than a sweep of the laser and the steps that are taken at once
AT_ONCE = 20
_SETTLE = 0.3  # [s] for the wheels to sink into the floor before time begins
LEVER = 0.1  # of a finger, from its tip to its joint [m]


@dataclass(frozen=True, eq=False)
class Truth:
    """What really is at `stamp` [s], as motion capture would see it.

    base (3,) [m, m, rad], twist (3,) in the body's axes, q (n,) base first, tool T_world_tool (4, 4).
    """

    stamp: float
    base: Float[np.ndarray, "3"]
    twist: Float[np.ndarray, "3"]
    q: Float[np.ndarray, " n"]
    tool: Float[np.ndarray, "4 4"]


def arm_limits(robot: MobileManipulator) -> JointLimits:
    """Return the limits of the arm's joints."""
    return JointLimits(**{f.name: getattr(robot.limits, f.name)[robot.arm] for f in fields(JointLimits)})


class Motion:
    """A robot in a world, moved by its drivers; after each step its state is the last row of four memories.

    qpos, qvel, sensed: as MuJoCo has them; bases (PAST, 3): poses of the base, headings not wrapped.
    """

    def __init__(self, robot: MobileManipulator, world: World, q: Float[np.ndarray, " n"], stiffness: float) -> None:
        self.robot, self.step, self._stiffness = robot, 0, stiffness
        self.model = compiled(mjcf(robot, world))
        self.data = engine().MjData(self.model)
        self.at = Places(robot, self.model)
        self._place(q)
        self.qpos, self.qvel = np.tile(self.data.qpos, (PAST, 1)), np.tile(self.data.qvel, (PAST, 1))
        self.sensed, self.bases = np.tile(self.data.sensordata, (PAST, 1)), np.tile(q[robot.base], (PAST, 1))
        base, description = robot.description.base, robot.description
        if not isinstance(base, MecanumBase):
            raise ConfigError(f"{robot.name} has no mecanum wheels.")
        fast, hard = np.array(description.velocity_limits), np.array(description.acceleration_limits)
        self.base = BaseDriver(base, fast, hard, np.zeros(3), np.zeros(3))
        rest = np.zeros(len(self.at.arm_names))
        self.arm = ArmDriver(arm_limits(robot), np.array(q[robot.arm]), rest, rest)
        self.gripper = GripperDriver()

    def _place(self, q: Float[np.ndarray, " n"]) -> None:
        """Put the robot down where q says, and let it settle."""
        model, data, at = self.model, self.data, self.at
        x, y, heading = q[self.robot.base]
        data.qpos[:7] = x, y, 0.0, math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)
        data.qpos[at.arm] = data.ctrl[at.arm_motors] = q[self.robot.arm]
        set_gains(model, data, self._stiffness)
        model.actuator_forcelimited[at.finger_motors] = 1
        engine().mj_step(model, data, round(_SETTLE / STEP))
        data.qpos[at.wheels] = 0.0
        engine().mj_forward(model, data)

    @property
    def stamp(self) -> float:
        """The time [s]."""
        return self.step * STEP

    def run(self, count: int) -> None:
        """Take steps, at most AT_ONCE, and remember the state after each of them."""
        data, take = self.data, engine().mj_step
        for past in (self.qpos, self.qvel, self.sensed, self.bases):
            past[:-count] = past[count:]
        for row, ctrl in enumerate(self._controls(count), PAST - count):
            data.ctrl[:] = ctrl
            take(self.model, data)
            self.qpos[row], self.qvel[row], self.sensed[row] = data.qpos, data.qvel, data.sensordata
        w, x, y, z = self.qpos[-count:, 3:7].T
        heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        self.bases[-count:, :2] = self.qpos[-count:, :2]
        self.bases[-count:, 2] = np.unwrap(np.append(self.bases[-count - 1, 2], heading))[1:]
        self.step += count

    def _controls(self, count: int) -> Float[np.ndarray, "count motors"]:
        """Return what the drivers tell each motor in the next steps."""
        at, model, now = self.at, self.model, self.stamp
        ctrl = np.empty((count, model.nu))
        ctrl[:, at.wheel_motors] = self.base.speeds(now, STEP, count)
        q, v = self.arm.steps(now, STEP, count)
        # A motor's force is k (u - q) - d q̇ with d = 2 k / stiffness; this u makes it k (q_d - q) + d (v_d - q̇).
        ctrl[:, at.arm_motors] = q + 2.0 / self._stiffness * v
        ctrl[:, at.finger_motors] = self.gripper.next(count * STEP) * at.closed
        model.actuator_forcerange[at.finger_motors] = np.array([-1.0, 1.0]) * LEVER * self.gripper.force
        return ctrl

    def truth(self) -> Truth:
        """Return what is, now."""
        data, at = self.data, self.at
        engine().mj_kinematics(self.model, data)  # MuJoCo places the bodies before a step, not after it
        q = self.robot.home
        q[self.robot.base], q[self.robot.arm] = self.bases[-1], data.qpos[at.arm]
        T_world_last = np.eye(4)
        T_world_last[:3, :3], T_world_last[:3, 3] = data.xmat[at.last].reshape(3, 3), data.xpos[at.last]
        R = data.xmat[at.root].reshape(3, 3)
        twist = np.append((R.T @ data.qvel[:3])[:2], data.qvel[5])
        base = se2.compose(np.zeros(3), self.bases[-1])
        return Truth(self.stamp, base, twist, q, T_world_last @ at.T_last_tool)
