"""A simulated robot without forces, behind the same `Hardware` as the one with physics, for runs by the thousand.

Any described robot can be simulated: on mecanum wheels, with differential drive, with a driver that makes odometry of
its wheels, with or without an arm, or bolted down. It keeps to its speeds and accelerations, its arm is where it is
told to be, and its base lacks of each axis what a mecanum base with physics lacks, and a part that wanders. It meets no
walls, and has no wrench and no pictures.
"""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from longreach.control.hardware import Capabilities, Command, Readings
from longreach.errors import ConfigError
from longreach.geometry import se2
from longreach.measurement import GripperState, Imu, JointState, Odometry, WheelSpeeds, WheelTicks, frozen_array
from longreach.robot.description import Mount
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim._kinematic_kernels import move, parts, size, take
from longreach.sim.drivers import GripperDriver
from longreach.sim.kinematic_config import KINDS, STEP, KinematicConfig, moving_axes, traits_of
from longreach.sim.places import Hand
from longreach.sim.sensors import Line, Scanner, unchecked
from longreach.sim.simulated import Truth, capabilities_of, check_command
from longreach.sim.worlds import World, load_world

_AT_ONCE = 500  # steps in one call
_PAST = 64  # steps before them that are remembered, for the laser's sweeps
_DRAWN = 8192  # random numbers at once
_NOTHING = frozen_array([], (0,), "nothing")


class KinematicRobot:
    """A robot in a world; see `longreach.control.hardware.Hardware`. Time passes in `advance` alone.

    The same arguments and the same calls give the same readings, bit for bit.

    Arguments: world: a name, a YAML file or a `World`, for the laser alone; q (n,): where the robot stands at the
    start, base first, else at its home.

    Raises:
        ConfigError: there is no such world.
    """

    def __init__(
        self,
        robot: MobileManipulator,
        world: World | str | Path = "laboratory",
        *,
        seed: int = 0,
        q: Float[np.ndarray, " n"] | None = None,
        config: KinematicConfig | None = None,
    ) -> None:
        self.robot, self.config = robot, config or KinematicConfig()
        self.hit = ""  # without forces it passes through everything
        self.world = world if isinstance(world, World) else load_world(world)
        self.capabilities: Capabilities = capabilities_of(robot, self.config.timeout)
        self._hand, self._gripper, self._step, self._stopped = Hand.of(robot), GripperDriver(), 0, ""
        limits, fast = self.capabilities.arm_limits, self.capabilities.arm_limits.velocity
        top = np.array(robot.description.velocity_limits) * moving_axes(robot.description)
        self._fast = (-top, top)
        self._bounds = {True: (limits.lower, limits.upper), False: (-fast, fast)}  # of angles, of speeds
        self._names = (*self.capabilities.arm_names, *self._hand.names)
        self._start = robot.home if q is None else np.array(q, dtype=float)
        encoder, imu = robot.description.encoder, robot.description.imu
        closing = [(i, a) for i, a in enumerate(self._hand.closed.tolist(), len(limits.lower)) if a > 0]
        self._finger = closing[0] if closing else None  # one that tells how far all are closed
        self._speeds, self._imu_frame = encoder is not None and encoder.signal == "speed", (imu and imu.frame) or "imu"
        self._odometer = np.zeros((2, 3))  # of a driver that makes odometry: what its wheels had turned, its pose
        wheels = self._odometry if robot.description.base is None else self._wheels
        self._makers = {"wheels": wheels, "imu": self._imu, "joints": self._joints}
        self._fit_motion(seed)
        self._fit_lidar()
        self._advance(0)

    def _fit_motion(self, seed: int) -> None:
        """Place the robot, and give each sensor its schedule and a stream of random numbers of its own."""
        robot, sensors, n = self.robot, self.config.sensors, len(self.capabilities.arm_names)
        for_draws, for_lines = (rng.spawn(len(KINDS) + 1) for rng in np.random.default_rng(seed).spawn(2))
        self._rngs, self._noise = for_draws[:3], for_draws[3]
        names = (*KINDS, "lidar")
        self._lines = {name: Line(getattr(sensors, name), rng) for name, rng in zip(names, for_lines, strict=True)}
        traits = traits_of(robot, self.config)
        self._sizes = np.array([len(traits.inverse), n, len(traits.closed)])
        self._memory = np.zeros(size(*self._sizes.tolist()))
        self._state, self._orders, known = parts.py_func(self._memory, *self._sizes.tolist())
        for part, value in zip(known, traits, strict=True):
            part[:] = value
        state, never, imu = self._state, -math.inf, robot.description.imu
        state.base[0, : robot.base.stop], state.arm[0] = self._start[robot.base], self._start[robot.arm]
        state.base[3] = traits.slip[1] * self._noise.standard_normal(3)
        state.bias[:] = (imu.gyro_bias_deviation if imu else 0.0) * self._noise.standard_normal(3)
        self._orders.base[3] = self._orders.hold[2] = never
        rates = known.rates
        state.due[:] = np.where(rates > 0, 0.0, math.inf)
        if rates[1] > 0:
            state.due[1] = math.ceil(1.0 / (rates[1] * STEP) - 1e-6)  # the IMU tells the mean since its last reading
        self._draws, state.used[:] = np.empty((3, _DRAWN)), _DRAWN
        self._draw()
        width = 8 + max(2 * len(self._names), n)
        self._out = np.empty((len(KINDS), _AT_ONCE, width))
        self._true: list[np.ndarray] = []
        self._path = np.tile(state.base[0], (_PAST + _AT_ONCE, 1))

    def _fit_lidar(self) -> None:
        lidar, self._scanner = self.robot.description.lidar, None
        if "lidar" in self.config.present and lidar is not None:
            seen = self.world.at_height((lidar.mount or Mount()).z)
            self._scanner = Scanner.of(lidar, self.config.sensors.lidar, seen)

    @property
    def stamp(self) -> float:
        """The time [s]."""
        return self._step * STEP

    @property
    def stopped(self) -> str:
        """Why the robot was stopped, or nothing."""
        return self._stopped

    def read(self) -> Readings:
        """Return everything that has arrived since the last call."""
        now, lines, gripper = self.stamp, self._lines, None
        wheels, scans, imu, joints = (lines[kind].take(now) for kind in ("wheels", "lidar", "imu", "joints"))
        if joints and self._finger is not None:
            i, angle = self._finger
            last = joints[-1]
            gripper = GripperState(last.stamp, float(last.position[i]) / angle, float(last.velocity[i]) / angle)
        return Readings(now, wheels, scans, imu, joints, gripper=gripper)

    def write(self, command: Command) -> None:
        """Take a command; after a stop none is taken.

        Raises:
            ControlError: numbers that are not finite, or not one for each joint.
        """
        if self._stopped:
            return
        orders, now = self._orders, self.stamp
        if command.base is not None:
            if not (len(command.base) == 3 and take(command.base, *self._fast, orders.base[:3])):
                check_command(command, len(orders.arm))
            orders.base[3] = now + self.config.timeout
        if command.arm is not None:
            angles = command.arm_mode == "position"
            if not (len(command.arm) == len(orders.arm) and take(command.arm, *self._bounds[angles], orders.arm)):
                check_command(command, len(orders.arm))
            orders.hold[:] = angles, now + 1.0 / self.capabilities.arm_rate, now + self.config.timeout
        if command.gripper is not None:
            self._gripper.take(command.gripper)
            orders.fingers[:] = self._gripper.wanted, self._gripper.speed

    def stop(self, reason: str) -> None:
        """Brake base and arm within their accelerations, and take no more commands."""
        self._stopped = self._stopped or reason
        self._orders.base[3] = -math.inf
        self._orders.hold[:] = 0.0, 0.0, -math.inf

    def advance(self, duration: float) -> None:
        """Let time pass [s], in whole milliseconds.

        Raises:
            ConfigError: the duration is none.
        """
        if not 0.0 <= duration < math.inf:
            raise ConfigError(f"Time can pass by 0 s or more, but not by {duration} s.")
        end = self._step + round(duration / STEP)
        while self._step < end:
            count = min(_AT_ONCE, end - self._step)
            if max(self._state.used.tolist()) > _DRAWN // 2:
                self._draw()
            self._advance(count)

    def _advance(self, count: int) -> None:
        path, known = self._path, (self._memory, self._sizes, self._draws)
        rows = move(self._step, count, STEP, *known, path[_PAST : _PAST + count], self._out)
        self._step += count
        self._send(rows)
        if self._scanner is not None:
            self._scan(self._step - count)
        path[:_PAST] = path[count : count + _PAST]

    def truth(self) -> Truth:
        """Return what really is, now."""
        state = self._state
        return self._truths(np.concatenate([[self._step], *state.base[:2], state.arm[0]])[None])[0]

    def truths(self) -> list[Truth]:
        """Return what motion capture saw so far, at its rate."""
        return self._truths(np.concatenate(self._true))

    def _truths(self, rows: Float[np.ndarray, "n k"]) -> list[Truth]:
        q = np.tile(self._start, (len(rows), 1))
        q[:, self.robot.base], q[:, self.robot.arm] = (
            rows[:, 1 : 1 + self.robot.base.stop],
            rows[:, 7:][:, : len(self._orders.arm)],
        )
        base = rows[:, 1:4].copy()
        base[:, 2] = (base[:, 2] + math.pi) % (2 * math.pi) - math.pi
        known = (_stamps(rows), base, rows[:, 4:7], q, self.robot.forward(q))
        return [Truth(*values) for values in zip(*known, strict=True)]

    def _draw(self) -> None:
        """Draw as many random numbers as were used, behind those that were not."""
        for row, rng, used in zip(self._draws, self._rngs, self._state.used.astype(int).tolist(), strict=True):
            left = _DRAWN - used
            row[:left] = row[used:].copy()
            row[left:] = rng.standard_normal(used)
        self._state.used[:] = 0.0

    def _send(self, rows: Int[np.ndarray, "4"]) -> None:
        """Send what the sensors read on its way, as records."""
        for kind, count, table in zip(KINDS, rows.tolist(), self._out, strict=True):
            if count == 0:
                continue
            if kind == "truth":
                self._true.append(table[:count].copy())
                continue
            line, make, read = self._lines[kind], self._makers[kind], table[:count].copy()
            read.flags.writeable = False
            for step, row in zip(read[:, 0].tolist(), read, strict=True):
                end = round(step * STEP, 9)
                line.send(make(end, row), end)

    def _wheels(self, stamp: float, row: Float[np.ndarray, " m"]) -> WheelTicks | WheelSpeeds:
        n = len(self._state.wheels)
        if self._speeds:
            return unchecked(WheelSpeeds, stamp=stamp, speeds=row[1 + n : 1 + 2 * n])
        return unchecked(WheelTicks, stamp=stamp, ticks=row[1 : 1 + n])

    def _odometry(self, stamp: float, row: Float[np.ndarray, " m"]) -> Odometry:
        turned, pose = self._odometer
        step = row[1:4] - turned
        self._odometer = np.stack([row[1:4], se2.retract(pose, step)])
        return unchecked(
            Odometry,
            stamp=stamp,
            pose=self._odometer[1].copy(),
            twist=row[4:7],
            pose_covariance=None,
            twist_covariance=None,
        )

    def _imu(self, end: float, row: Float[np.ndarray, " m"]) -> Imu:
        stamp = round(end - 0.5 * STEP * float(row[7]), 9)  # the middle of the time that it is the mean of
        return unchecked(Imu, stamp=stamp, angular_velocity=row[1:4], acceleration=row[4:7], frame=self._imu_frame)

    def _joints(self, stamp: float, row: Float[np.ndarray, " m"]) -> JointState:
        k = len(self._names)
        q, v = row[1 : 1 + k], row[1 + k : 1 + 2 * k]
        return unchecked(JointState, stamp=stamp, names=self._names, position=q, velocity=v, effort=_NOTHING)

    def _scan(self, before: int) -> None:
        """Sweep as often as a sweep has ended; `before`: the step that the last of the remembered poses belongs to."""
        scanner, line = self._scanner, self._lines["lidar"]
        assert scanner is not None
        first, poses = (before - _PAST + 1) * STEP, self._path[: _PAST + self._step - before]
        while (end := line.due + scanner.duration) <= self.stamp + 1e-9:
            scan = scanner.read(round(line.due, 9), first, STEP, poses, self._noise)
            line.send(scan, end)
            line.count += 1


def _stamps(rows: Float[np.ndarray, "n k"]) -> list[float]:
    """Return the stamps of a table's rows, in whole nanoseconds as a message holds them."""
    return [round(step * STEP, 9) for step in rows[:, 0].tolist()]
