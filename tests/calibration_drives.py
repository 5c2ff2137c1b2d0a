"""Drives of simulated bases as motions between keyframes, with noise of wheels and sensor, for calibration."""

import numpy as np

from longreach.calibration.wheels import Motions, base_motion
from longreach.geometry import se2
from longreach.robot.description import RobotDescription

DIFFERENTIAL = RobotDescription(name="cart", base={"kind": "differential", "wheel_radius": 0.1, "track_width": 0.4})
MECANUM = RobotDescription(
    name="thing", base={"kind": "mecanum", "wheel_radius": 0.1, "half_length": 0.2, "half_width": 0.2}
)
ODOMETRY = RobotDescription(name="driven")
SKID = RobotDescription(
    name="skid",
    base={
        "kind": "differential",
        "wheel_radius": 0.1,
        "track_width": 0.6,
        "wheel_names": ["left_1", "left_2", "right_1"],
    },
)


def motions_of(rng, model, true, mount, twists, sigma=(0.001, 0.001, 0.001), steps=5):
    """Motions of a base that is driven with `twists` (n, 3) in steps, each motion of equal steps.

    true: parameters of the wheels, after which systematic slip may follow.
    """
    F, _ = model.matrix(true[: len(model.nominal)])
    inverse = rolling(model, true) if len(model.signs) else np.linalg.pinv(F)
    turns = np.repeat(np.asarray(twists) @ inverse.T / steps, steps, axis=0)
    edges = np.arange(len(twists) + 1) * steps
    spans = np.column_stack((edges[:-1], edges[1:]))
    o, _ = base_motion(model, true, Motions(turns, spans, np.zeros((len(twists), 3))))
    s = se2.compose(se2.compose(se2.inverse(mount), o), mount)
    return Motions(turns, spans, se2.retract(s, rng.normal(size=s.shape) * sigma))


def rolling(model, true):
    """Turns of mecanum wheels that all roll: r w = 4 F' twist, with F's rows of unit radius and the arm k.

    With systematic slip they are those that move the base so all the same.
    """
    k, slip = true[4], true[5:]
    G = 4.0 * model.matrix(np.array([1.0, 1.0, 1.0, 1.0, k]))[0].T
    turns = G * [1.0, 1.0, k**2] / true[:4, None]
    if len(slip) == 0:
        return turns
    whole = np.concatenate((model.matrix(true[:5])[0], model.signs * true[:4])) + np.tensordot(slip, model.slip, 1)
    return np.linalg.inv(whole)[:, :3]


def straight(n, v=0.1):
    return np.array([[v if i // 20 % 2 else -v, 0.0, 0.0] for i in range(n)])


def sideways(n, v=0.1):
    return np.array([[0.0, v if i // 20 % 2 else -v, 0.0] for i in range(n)])


def turning(n, w=0.15):
    return np.array([[0.0, 0.0, w if i // 60 % 2 else -w] for i in range(n)])


def arc(n, v=0.1, w=0.1):
    return np.tile([v, 0.0, w], (n, 1))
