"""True states drawn from the motion model that the filter assumes: test cases for its consistency."""

import numpy as np

from longreach.estimation.planar import _ekf_kernels as kernels
from longreach.estimation.planar.motion_model import retract


def draw(model, state, dt, rng):
    """Draw the true state (13,) after dt [s]."""
    if dt == 0.0:
        return state.copy()
    f, g, e, q = kernels.singer(float(dt), model.time_constant)
    unit = np.array([[q[0], q[1], q[2]], [q[1], q[3], q[4]], [q[2], q[4], q[5]]])
    scale = np.sqrt(np.diag(unit))
    root = scale[:, None] * np.linalg.cholesky(unit / np.outer(scale, scale))
    noise = root @ rng.standard_normal((3, 3)) * np.sqrt(model.acceleration_variance)
    v, a = state[3:6], state[6:9]
    error = np.zeros(13)
    error[:3] = dt * v + f * a + noise[0]
    error[3:6] = g * a + noise[1]
    error[6:9] = (e - 1.0) * a + noise[2]
    error[9] = np.sqrt(model.bias_walk * dt) * rng.standard_normal()
    return retract(state, error)
