"""How a simulated robot moves: the model in MuJoCo, its drivers, and the last steps as a memory for its sensors."""

import math

import numpy as np
from jaxtyping import Float

from longreach.errors import ConfigError
from longreach.geometry import se3, so3
from longreach.robot.bases import MecanumBase
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim._driver_kernels import planar
from longreach.sim.drivers import ArmDriver, BaseDriver, GripperDriver
from longreach.sim.mujoco_model import STEP, THING, compiled, engine, mjcf, set_gains
from longreach.sim.places import Places
from longreach.sim.simulated import Truth, arm_limits
from longreach.sim.worlds import World

PAST = 64  # steps that are remembered: more than a sweep of the laser and the steps that are taken at once
AT_ONCE = 20
_PAGE = 1024  # rows of a memory before it is copied back to its top
_SETTLE = 0.3  # [s] for the wheels to sink into the floor before time begins
LEVER = 0.1  # of a finger, from its tip to its joint [m]

Glimpse = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # rows of the memories bases, qpos, qvel, sensed


class Motion:
    """A robot in a world, moved by its drivers; after each step its state is the last row of four memories (PAST, ...).

    qpos, qvel, sensed: as MuJoCo has them; bases (PAST, 3): poses of the base, headings not wrapped.
    """

    def __init__(self, robot: MobileManipulator, world: World, q: Float[np.ndarray, " n"], stiffness: float) -> None:
        self.robot, self.step, self._stiffness, self._q = robot, 0, stiffness, np.array(q, dtype=float)
        self.model = compiled(mjcf(robot, world))
        self.data = engine().MjData(self.model)
        self.at = Places(robot, self.model)
        self._place(q)
        mujoco = engine()
        self._full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.empty(mujoco.mj_stateSize(self.model, self._full))
        mujoco.mj_getState(self.model, self.data, state, self._full)
        start = (state, self.data.sensordata, q[robot.base])
        self._pages, self._end = [np.tile(values, (_PAGE, 1)) for values in start], PAST
        self._turn(0)
        self._rollout, self._floor = engine("rollout").Rollout(nthread=0), self.model.geom("floor").id
        base, description = robot.description.base, robot.description
        if not isinstance(base, MecanumBase):
            raise ConfigError(f"{robot.name} has no mecanum wheels.")
        fast, hard = np.array(description.velocity_limits), np.array(description.acceleration_limits)
        self.base = BaseDriver(base, fast, hard, np.zeros(3), np.zeros(3))
        rest = np.zeros(len(self.at.arm_names))
        self.arm = ArmDriver(arm_limits(robot), np.array(q[robot.arm]), rest.copy(), rest)
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

    def _turn(self, count: int) -> None:
        """Make room for the next steps at the end of the memories; what is remembered goes to a new page's top."""
        if self._end + count > _PAGE:
            for page in self._pages:
                page[:PAST] = page[self._end - PAST : self._end].copy()
            self._end = PAST
        self._end += count
        state, self.sensed, self.bases = [page[self._end - PAST : self._end] for page in self._pages]
        nq, nv = self.model.nq, self.model.nv
        self.qpos, self.qvel = state[:, 1 : 1 + nq], state[:, 1 + nq : 1 + nq + nv]

    def run(self, count: int) -> None:
        """Take steps, at most AT_ONCE, and remember the state after each of them."""
        self._turn(count)
        data, (state, sensed, _), end = self.data, self._pages, self._end
        # All steps in one call: what Python does between two of them would cost a tenth of them.
        self._rollout.rollout(
            [self.model],
            [data],
            state[None, end - count - 1].copy(),
            self._controls(count)[None],
            skip_checks=True,
            nstep=count,
            initial_warmstart=data.qacc_warmstart[None].copy(),
            state=state[None, end - count : end],
            sensordata=sensed[None, end - count : end],
        )
        planar(self.qpos[-count:], self.bases[-count - 1 :])
        self.step += count

    def _controls(self, count: int) -> Float[np.ndarray, "count motors"]:
        """Return what the drivers tell each motor in the next steps."""
        at, now = self.at, self.stamp
        ctrl = np.empty((count, self.model.nu))
        ctrl[:, at.wheel_motors] = self.base.speeds(now, STEP, count)
        q, v = self.arm.steps(now, STEP, count)
        # A motor's force is k (u - q) - d q̇ with d = 2 k / stiffness; this u makes it k (q_d - q) + d (v_d - q̇).
        ctrl[:, at.arm_motors] = q + 2.0 / self._stiffness * v
        ctrl[:, at.finger_motors] = self.gripper.next(count * STEP) * at.closed
        torque = LEVER * self.gripper.force
        self.model.actuator_forcerange[at.finger_motors] = (-torque, torque)
        return ctrl

    def touching(self) -> str:
        """Return the name of a link that touches something else than the floor at the newest step, or nothing."""
        pairs = self.data.contact.geom
        touching = pairs[(pairs != self._floor).all(axis=1)]
        bodies = [self.model.body(self.model.geom_bodyid[geom]).name for pair in touching for geom in pair]
        return next((name for name in bodies if not name.startswith(THING)), "")

    def truth(self) -> Truth:
        """Return what is, now."""
        data, at = self.data, self.at
        engine().mj_kinematics(self.model, data)  # MuJoCo places the bodies before a step, not after it
        R = data.xmat[at.last].reshape(3, 3)
        return self._truth(self.step, self.bases[-1], self.qpos[-1], self.qvel[-1], data.xpos[at.last], R)

    def glimpse(self, row: int) -> Glimpse:
        """Return what `truth_of` needs of one step before a remembered one: only after it all places are known."""
        return self.bases[row - 1].copy(), self.qpos[row - 1].copy(), self.qvel[row - 1].copy(), self.sensed[row].copy()

    def truth_of(self, step: int, glimpse: Glimpse) -> Truth:
        """Return what was at a step of which there is a glimpse."""
        base, qpos, qvel, sensed = glimpse
        p, x, y = sensed[self.at.last_frame].reshape(3, 3)
        return self._truth(step, base, qpos, qvel, p, np.array([x, y, so3.hat(x) @ y]).T)

    def _truth(
        self, step: int, base: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, p: np.ndarray, R: np.ndarray
    ) -> Truth:
        """Return what was at a step, when the last link was at p and R."""
        q = self._q.copy()
        q[self.robot.base], q[self.robot.arm] = base, qpos[self.at.arm]
        c, s = math.cos(base[2]), math.sin(base[2])
        twist = np.array([c * qvel[0] + s * qvel[1], -s * qvel[0] + c * qvel[1], qvel[5]])
        T_world_tool = se3.from_rotation_translation(R, p) @ self.at.T_last_tool
        return Truth(step * STEP, np.append(base[:2], _wrapped(base[2:])), twist, q, T_world_tool)


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """Return angles within ±π."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
