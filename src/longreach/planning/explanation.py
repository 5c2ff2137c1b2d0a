"""Why a task is not met: by itself it cannot be, something of higher priority holds it, or it was not done yet."""

import numpy as np
from jaxtyping import Float

from longreach.planning.stack import Stack

_LEFT = 0.05  # part of the way down the error that counts as none
_AT = 1e-6  # [m, rad] from a bound that counts as on it


def size_text(linear: float, angular: float) -> str:
    """Return an error as text, in millimetres, or metres from one on, and degrees."""
    length = f"{linear:.3g} m" if linear >= 1.0 else f"{1e3 * linear:.3g} mm"
    parts = [length] * (linear > 0) + [f"{np.degrees(angular):.3g}°"] * (angular > 0)
    return " and ".join(parts) or "nothing"


def why(stack: Stack, q: Float[np.ndarray, " n"], task: int, hurried: bool = False) -> str:
    """Return a sentence about a task that is not met at q: by how much, and what stands against it.

    Where the way down its error is closed by the rows of a task above it, that one is named. hurried: whether a joint
    was at its limit of speed.
    """
    e, A = stack.rows(q)
    linear, angular = stack.sizes(e)[:, task].tolist()
    start = f"The {stack.tasks[task].name} is off by {size_text(linear, angular)}"
    mine = stack.owner == task
    error = e - np.clip(e, stack.lower, stack.upper)
    down = -A[mine].T @ error[mine]
    far = float(np.linalg.norm(down))
    if far <= _LEFT * 1e-2 * float(np.linalg.norm(error[mine])):
        return f"{start}: it cannot be reached."
    basis = np.empty((0, len(q)))
    for other in range(task):
        left = down - basis.T @ (basis @ down)
        rows = _holding(stack, other, e, A, left)
        basis = _row_space(np.vstack([basis, rows]))
        left = down - basis.T @ (basis @ down)
        if np.linalg.norm(left) <= _LEFT * far:
            if stack.tasks[other].ranged:
                return f"{start}: {stack.tasks[other].name} holds it."
            return f"{start}: it conflicts with {stack.tasks[other].name}."
    if hurried:
        return f"{start}: a joint is at its limit of speed."
    return f"{start}: the iterations ran out."


def _holding(stack: Stack, task: int, e: np.ndarray, A: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Return the rows of a task that bar the given way: all of an equation, of a range those that it would leave."""
    rows = stack.owner == task
    moves = A @ way
    at_lower, at_upper = e <= stack.lower + _AT, e >= stack.upper - _AT
    return A[rows & (~stack.ranged | (at_lower & (moves < 0)) | (at_upper & (moves > 0)))]


def _row_space(A: np.ndarray) -> np.ndarray:
    if len(A) == 0:
        return A
    _, s, V = np.linalg.svd(A, full_matrices=False)
    return V[s > 1e-6 * max(s[0], 1e-300)]
