"""A robot without forces, compiled: base, arm and fingers do as they are told, but for a slip; what sensors then read.

A step is dt long. Rows that a sensor writes begin with the step at whose end it read.
"""

import math
from typing import NamedTuple

import numpy as np

from longreach.kernels import kernel
from longreach.sim._driver_kernels import copy, reach

WHEELS, IMU, JOINTS, TRUTH = 0, 1, 2, 3  # rows of `due` and `rates`
GRAVITY = 9.81  # [m/s²]


class State(NamedTuple):
    """What changes from step to step.

    base (4, 3): pose, its heading not wrapped; body twist; twist that the wheels turn for; slip that wanders.
    wheels (w,) [rad]. arm (2, n): angles, speeds. fingers (2,): how far closed, how fast. felt (5,): sums of specific
    force and ω since the IMU last read, and of how many steps. bias (3,): of its gyro. due (4,):
    at which step's end each sensor reads next. used (3,): of the numbers drawn for slip, IMU and joints.
    """

    base: np.ndarray
    wheels: np.ndarray
    arm: np.ndarray
    fingers: np.ndarray
    felt: np.ndarray
    bias: np.ndarray
    due: np.ndarray
    used: np.ndarray


class Orders(NamedTuple):
    """What holds now. base (4,): twist, and until when. arm (n,): speeds or angles; hold (3,): whether they are
    angles, when these are reached, until when speeds hold. fingers (2,): how far closed, how fast."""

    base: np.ndarray
    arm: np.ndarray
    hold: np.ndarray
    fingers: np.ndarray


class Traits(NamedTuple):
    """What stays. base: accelerations (3,). arm (4, n): lower, upper, v_max, a_max. inverse (w, 3): wheels' speeds from
    a twist. slip (3, 3): part of each axis that is lost; deviation of what wanders about it; how much of that a step
    keeps. imu (4, 3): axes of the sensor in the base, as rows, and where it is. closed (k,): angles of closed fingers.
    noise (7,): wheels' resolution [rad] or 0, its size in a message, gyro, acceleration, the bias' walk from reading to
    reading, angles and speeds of joints. rates (4,): of the sensors [Hz], 0 where there is none.
    """

    base: np.ndarray
    arm: np.ndarray
    inverse: np.ndarray
    slip: np.ndarray
    imu: np.ndarray
    closed: np.ndarray
    noise: np.ndarray
    rates: np.ndarray


@kernel
def parts(memory, w, n, k):
    """Name the parts of one array of `size(w, n, k)` numbers, for w wheels, n joints and k fingers' joints.

    One array, for each that is handed over by Python takes half a microsecond, as long as two steps.
    """
    pose, wheel, arm = memory[0:12].reshape(4, 3), memory[12 : 12 + w], memory[12 + w : 12 + w + 2 * n].reshape(2, n)
    x = memory[12 + w + 2 * n :]
    state = State(pose, wheel, arm, x[0:2], x[2:7], x[7:10], x[10:14], x[14:17])
    x = x[17:]
    orders = Orders(x[0:4], x[4 : 4 + n], x[4 + n : 7 + n], x[7 + n : 9 + n])
    x = x[9 + n :]
    base, limits, inverse = x[0:3], x[3 : 3 + 4 * n].reshape(4, n), x[3 + 4 * n : 3 + 4 * n + 3 * w].reshape(w, 3)
    x = x[3 + 4 * n + 3 * w :]
    slip, imu, closed, noise, rates = x[0:9], x[9:21], x[21 : 21 + k], x[21 + k : 28 + k], x[28 + k : 32 + k]
    traits = Traits(base, limits, inverse, slip.reshape(3, 3), imu.reshape(4, 3), closed, noise, rates)
    return state, orders, traits


def size(w, n, k):
    """How many numbers `parts` shares out."""
    return 73 + 4 * w + 7 * n + k


@kernel
def move(step, count, dt, memory, sizes, draws, path, out):
    """Take steps; path (count, 3) becomes the base's poses after each, out (4, rows, width) what the sensors read.

    memory: of `parts` with these sizes (3,). draws (3, k): normal numbers for slip, IMU and joints. Returns how many
    rows each sensor has written.
    """
    state, orders, traits = parts(memory, sizes[0], sizes[1], sizes[2])
    rows = np.zeros(4, dtype=np.int64)
    for k in range(-1, count):  # first what is due before the first step
        if k >= 0:
            now = (step + k) * dt
            _wander(state, traits, draws[0])
            _drive(now, dt, state, orders, traits)
            _bend(now, dt, state, orders, traits)
            copy(state.base[0], path[k])
        for sensor in range(4):
            if step + k + 1 >= state.due[sensor]:
                _read(sensor, step + k + 1, dt, state, traits, draws, out[sensor, rows[sensor]])
                rows[sensor] += 1
    return rows


@kernel
def drive_all(twists, each, dt, memories, sizes, draws, poses, wheels):
    """Drive many bases, run by run: each twist of twists (runs, ticks, 3) for `each` steps.

    memories (runs, size); draws (runs, ticks, 3): slip wanders once a tick. Written: poses (runs, ticks + 1, 3) and
    the wheels' angles (runs, ticks + 1, w), the first rows where they begin.
    """
    for run in range(len(twists)):
        state, orders, traits = parts(memories[run], sizes[0], sizes[1], sizes[2])
        orders.base[3] = math.inf
        copy(state.base[0], poses[run, 0])
        copy(state.wheels, wheels[run, 0])
        for k in range(twists.shape[1]):
            state.used[0] = 0.0
            _wander(state, traits, draws[run, k])
            for i in range(3):
                orders.base[i] = twists[run, k, i]
            for _ in range(each):
                _drive(0.0, dt, state, orders, traits)
            copy(state.base[0], poses[run, k + 1])
            copy(state.wheels, wheels[run, k + 1])


@kernel
def take(values, low, high, out):
    """Clamp numbers into `out`; False where one is not finite."""
    for i in range(len(out)):
        if not math.isfinite(values[i]):
            return False
    for i in range(len(out)):
        out[i] = min(max(values[i], low[i]), high[i])
    return True


@kernel
def _next(step, rate, dt):
    """The step at whose end a sensor that read at one reads next; never at a rate of 0."""
    if rate <= 0.0:
        return math.inf
    return math.ceil((math.floor(step * dt * rate + 1e-6) + 1.0) / (rate * dt) - 1e-6)


@kernel
def _wander(state, traits, draws):
    """Let what slips beyond the usual part wander: an Ornstein-Uhlenbeck process an axis."""
    slip, at = state.base[3], int(state.used[0])
    for i in range(3):
        keep = traits.slip[2, i]
        slip[i] = keep * slip[i] + math.sqrt(1.0 - keep * keep) * traits.slip[1, i] * draws[at + i]
    state.used[0] += 3


@kernel
def _drive(now, dt, state, orders, traits):
    """Turn the wheels, slip, and move the base along an arc."""
    pose, twist, told, slip = state.base[0], state.base[1], state.base[2], state.base[3]
    for i in range(3):
        wanted = orders.base[i] if now < orders.base[3] else 0.0
        most = traits.base[i] * dt
        told[i] += min(max(wanted - told[i], -most), most)
    for w in range(len(state.wheels)):
        row = traits.inverse[w]
        state.wheels[w] += (row[0] * told[0] + row[1] * told[1] + row[2] * told[2]) * dt
    vx, vy, omega = twist[0], twist[1], twist[2]
    for i in range(3):
        twist[i] = (1.0 - traits.slip[0, i] - slip[i]) * told[i]
    _feel(dt, state, traits, vx, vy, omega)
    turn = twist[2] * dt
    a, b = 1.0 - turn * turn / 6.0, 0.5 * turn - turn**3 / 24.0  # sin(t)/t and (1 - cos(t))/t: a step turns little
    dx, dy = (a * twist[0] - b * twist[1]) * dt, (b * twist[0] + a * twist[1]) * dt
    c, s = math.cos(pose[2]), math.sin(pose[2])
    pose[0] += c * dx - s * dy
    pose[1] += s * dx + c * dy
    pose[2] += turn


@kernel
def _feel(dt, state, traits, vx, vy, omega):
    """Add what the IMU feels in a step: the change of the twist, its turn, and that it sits off the centre."""
    twist, (x, y) = state.base[1], (traits.imu[3, 0], traits.imu[3, 1])
    w, alpha = twist[2], (twist[2] - omega) / dt
    state.felt[0] += (twist[0] - vx) / dt - w * twist[1] - alpha * y - w * w * x
    state.felt[1] += (twist[1] - vy) / dt + w * twist[0] + alpha * x - w * w * y
    state.felt[2] += GRAVITY
    state.felt[3] += w
    state.felt[4] += 1.0


@kernel
def _bend(now, dt, state, orders, traits):
    """Move arm and fingers."""
    q, v = state.arm[0], state.arm[1]
    lower, upper, v_max, a_max = traits.arm[0], traits.arm[1], traits.arm[2], traits.arm[3]
    if orders.hold[0] > 0.0:
        reach(q, v, orders.arm, max(round((orders.hold[1] - now) / dt), 1), dt, lower, upper, v_max)
    else:
        part = 1.0 if now < orders.hold[2] else 0.0
        for i in range(len(q)):
            v[i] += min(max(part * orders.arm[i] - v[i], -a_max[i] * dt), a_max[i] * dt)
            q[i] = min(max(q[i] + v[i] * dt, lower[i]), upper[i])
    most = orders.fingers[1] * dt
    state.fingers[1] = min(max(orders.fingers[0] - state.fingers[0], -most), most) / dt
    state.fingers[0] += state.fingers[1] * dt


@kernel
def _read(sensor, step, dt, state, traits, draws, row):
    """Write one reading, and when the next one is due."""
    row[0] = step
    state.due[sensor] = _next(step, traits.rates[sensor], dt)
    if sensor == WHEELS:
        _read_wheels(state, traits, row[1:])
    elif sensor == IMU:
        _read_imu(state, traits, draws[1], row[1:])
    elif sensor == JOINTS:
        _read_joints(state, traits, draws[2], row[1:])
    else:
        copy(state.base[0], row[1:])
        copy(state.base[1], row[4:])
        copy(state.arm[0], row[7:])


@kernel
def _read_wheels(state, traits, row):
    """Angles as the encoder's message has them, then speeds."""
    resolution, size, told = traits.noise[0], traits.noise[1], state.base[2]
    for w in range(len(state.wheels)):
        angle = state.wheels[w]
        row[w] = math.floor(angle / resolution) * size if resolution > 0.0 else angle
        rate = traits.inverse[w]
        row[len(state.wheels) + w] = rate[0] * told[0] + rate[1] * told[1] + rate[2] * told[2]


@kernel
def _read_imu(state, traits, draws, row):
    """Mean rates and specific force since the last reading, in the sensor's axes; then how many steps that was."""
    steps = max(state.felt[4], 1.0)
    fx, fy, fz, w = state.felt[0] / steps, state.felt[1] / steps, state.felt[2] / steps, state.felt[3] / steps
    at = int(state.used[1])
    for i in range(3):
        axis = traits.imu[i]
        state.bias[i] += traits.noise[4] * draws[at + i]
        row[i] = axis[2] * w + state.bias[i] + traits.noise[2] * draws[at + 3 + i]
        row[3 + i] = axis[0] * fx + axis[1] * fy + axis[2] * fz + traits.noise[3] * draws[at + 6 + i]
    row[6] = steps
    state.used[1] += 9
    for i in range(5):
        state.felt[i] = 0.0


@kernel
def _read_joints(state, traits, draws, row):
    """Angles, then speeds, of arm and fingers."""
    n, k, at = state.arm.shape[1], len(traits.closed), int(state.used[2])
    both = n + k
    for i in range(both):
        for j in range(2):
            value = state.arm[j, i] if i < n else state.fingers[j] * traits.closed[i - n]
            row[j * both + i] = value + traits.noise[5 + j] * draws[at + 2 * i + j]
    state.used[2] += 2 * both
