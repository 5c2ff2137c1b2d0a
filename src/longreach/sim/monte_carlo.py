"""Drives of a slipping base by the thousand, compiled as a whole."""

import numpy as np
from jaxtyping import Float

from longreach.errors import ConfigError
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim._kinematic_kernels import drive_all, parts, size
from longreach.sim.kinematic_config import STEP, KinematicConfig, moving_axes, traits_of


def drive_many(
    robot: MobileManipulator,
    twists: Float[np.ndarray, "runs ticks 3"],
    tick: float = 0.02,
    *,
    seed: int = 0,
    config: KinematicConfig | None = None,
) -> tuple[Float[np.ndarray, "runs ticks1 3"], Float[np.ndarray, "runs ticks1 w"]]:
    """Drive a base many times over from the origin, and return its true poses and its wheels' angles [rad].

    Each of the twists is held for a tick [s], in whole milliseconds; rows of the results are ticks, from the start on.
    The heading is not wrapped. Slip wanders once a tick.

    Raises:
        ConfigError: the tick is shorter than a millisecond.
    """
    config, each = config or KinematicConfig(), round(tick / STEP)
    if each < 1:
        raise ConfigError(f"A tick lasts at least a millisecond, but {tick} s was asked for.")
    traits, (runs, ticks, _) = traits_of(robot, config), twists.shape
    keep = traits.slip[2]
    keep[:] = keep**each
    rng, sizes = np.random.default_rng(seed), np.array([len(traits.inverse), 0, 0])
    memories = np.zeros((runs, size(*sizes.tolist())))
    for memory, start in zip(memories, rng.standard_normal((runs, 3)), strict=True):
        state, _, known = parts.py_func(memory, *sizes.tolist())
        state.base[3] = traits.slip[1] * start
        known.base[:], known.inverse[:], known.slip[:], known.imu[:] = (
            traits.base,
            traits.inverse,
            traits.slip,
            traits.imu,
        )
    poses, wheels = np.empty((runs, ticks + 1, 3)), np.empty((runs, ticks + 1, len(traits.inverse)))
    draws = rng.standard_normal((runs, ticks, 3))
    twists = twists * moving_axes(robot.description)
    drive_all(twists, each, STEP, memories, sizes, draws, poses, wheels)
    return poses, wheels
