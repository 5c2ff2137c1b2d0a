"""Inverse kinematics: a configuration inside the limits that puts the tool at one pose, wherever the search starts.

Three stages, all in one compiled kernel, and the same for the same input:
1. a descent from the seed that never leaves the limits (`_descent_kernels`);
2. where the last six joints are an arm like the UR (`ur_arm`, told from the chain's numbers): the arm's closed form
   from where the descent brought the base, and of its postures the nearest to the seed; then from where the base was,
   and from places spread evenly between the base's limits. An arm that a calibration found to deviate takes the closed
   form as a start. An arm without a base needs no descent;
3. descents from starts spread evenly between all limits.
"""

from functools import lru_cache
from typing import NamedTuple, NoReturn

import numpy as np
from jaxtyping import Float

from longreach.errors import PlanningError
from longreach.geometry import se3
from longreach.planning import _ik_kernels
from longreach.planning._descent_kernels import REACHED
from longreach.planning.solution import Solution
from longreach.planning.ur_arm import ur_arm
from longreach.robot._kinematics_kernels import forward
from longreach.robot.chain import KinematicChain
from longreach.robot.mobile_manipulator import MobileManipulator, turned_like

Robot = KinematicChain | MobileManipulator
_FOUND = "The tool is at its target inside the limits."


class _Model(NamedTuple):
    """A robot as the kernels take it: transforms, which joints slide, limits with ratios (3, n), the closed form."""

    fixed: np.ndarray
    prismatic: np.ndarray
    span: np.ndarray
    ends: np.ndarray
    shape: np.ndarray


def _ratios(n: int) -> np.ndarray:
    """Return the ratios (n,) of Roberts' sequence: powers of 1/φ, φ the root of φ^(n+1) = φ + 1."""
    phi = 2.0
    for _ in range(60):
        phi = (1.0 + phi) ** (1.0 / (n + 1))
    return phi ** -np.arange(1.0, n + 1.0)


@lru_cache(maxsize=64)
def _model(robot: Robot) -> _Model:
    fixed, prismatic = robot.fixed, robot.prismatic
    arm = ur_arm(fixed, prismatic)
    span = np.array([robot.limits.lower, robot.limits.upper, _ratios(len(prismatic))])
    ends, shape = (np.zeros((0, 4, 4)), np.zeros((3, 6))) if arm is None else (arm.ends, arm.shape)
    return _Model(fixed, prismatic, span, ends, shape)


def solve_ik(robot: Robot, T_world_tool: Float[np.ndarray, "4 4"], q0: Float[np.ndarray, " n"]) -> Solution:
    """Find a configuration inside the limits with the tool at T_world_tool, near the seed q0 (n,) [rad or m].

    The seed may lie outside the limits; those of a base's heading are taken around the seed's whole turns. Of several
    postures of an arm like the UR the one nearest to the seed is taken.
    A pose that cannot be reached is answered too, with `converged` False and the nearest that was found: 1 m counts as
    much as 1 rad. `residuals`: "position" [m] and "orientation" [rad], below 1e-9 where converged.

    Raises:
        PlanningError: T_world_tool is not a rigid motion, q0 is not a number a joint, or one is not finite.
    """
    target, seed = np.array(T_world_tool, dtype=float, order="C"), np.array(q0, dtype=float)
    model = _model(robot if isinstance(robot, KinematicChain) or seed.ndim != 1 else turned_like(robot, seed))
    n = len(model.prismatic)
    if target.shape != (4, 4) or seed.shape != (n,):
        _refuse(_ik_kernels.WRONG_SHAPE, target, seed, n)
    q = np.empty(n)
    iterations, position, orientation = _ik_kernels.solve(*model, target, seed, q)
    if iterations < 0:
        _refuse(iterations, target, seed, n)
    q.setflags(write=False)
    residuals = {"position": position, "orientation": orientation}
    if position < REACHED and orientation < REACHED:
        return Solution(q, _FOUND, True, iterations, residuals, ())
    status = (
        f"No configuration inside the limits was found for this pose; the nearest leaves {position:.3g} m and "
        f"{orientation:.3g} rad."
    )
    violated = tuple(f"tool {name}" for name, left in residuals.items() if not left < REACHED)
    return Solution(q, status, False, iterations, residuals, violated)


def all_solutions(
    robot: Robot, T_world_tool: Float[np.ndarray, "4 4"], base: Float[np.ndarray, " b"] | None = None
) -> Float[np.ndarray, "k n"]:
    """Return every posture (k, n), k ≤ 8, of an arm like the UR that puts the tool at T_world_tool; [rad or m].

    Arguments: base (b,): the joints before the arm's six, [x, y, θ] of a mobile base; zeros unless given.
    Each joint is given once, by the whole turns that bring it nearest to 0 inside the limits; a posture with a joint
    that cannot be brought there is left out. Where axes 4 and 6 align, joint 6 is as near to 0 as it can be.

    Raises:
        PlanningError: the last six joints have no closed form, or an argument is wrong, as for `solve_ik`.
    """
    model = _model(robot)
    first, n = len(model.fixed) - 7, len(model.prismatic)
    if len(model.ends) == 0:
        raise PlanningError("The robot's last six joints are no arm like the UR; use solve_ik from several seeds.")
    q = np.zeros(n)
    target, given = np.array(T_world_tool, dtype=float), q[:first] if base is None else np.array(base, dtype=float)
    if given.shape != (first,):
        raise PlanningError(f"The base has {first} joints here, but `base` has the shape {given.shape}.")
    q[:first] = given
    wrong = _ik_kernels.fault(target, q, n) if target.shape == (4, 4) else _ik_kernels.WRONG_SHAPE
    if wrong < 0:
        _refuse(wrong, target, q, n)
    q[first:] = np.clip(0.0, model.span[0, first:], model.span[1, first:])
    return _postures(model, target, q, first)


def _postures(model: _Model, target: np.ndarray, q: np.ndarray, first: int) -> np.ndarray:
    """Return all postures (k, n) of the arm that begins with joint `first`, from where q puts its base."""
    T_root = np.empty((4, 4))
    forward(model.fixed[: first + 1], model.prismatic, q, T_root)
    fixed, span = model.fixed[first:].copy(), model.span[:, first : first + 6].copy()
    fixed[0] = np.eye(4)
    near, found = q[first : first + 6].copy(), np.empty((8, 6))
    target = np.ascontiguousarray(se3.compose(se3.inverse(T_root), target))
    arm = model.ends, model.shape
    count = _ik_kernels.all_postures(fixed, model.prismatic[first : first + 6].copy(), span, *arm, target, near, found)
    Q = np.tile(q, (count, 1))
    Q[:, first : first + 6] = found[:count]
    return Q


def _refuse(fault: int, target: np.ndarray, seed: np.ndarray, n: int) -> NoReturn:
    if fault == _ik_kernels.NOT_FINITE:
        which = "The pose" if not np.all(np.isfinite(target)) else "The seed or the base"
        raise PlanningError(f"{which} has NaN or infinity in it; give finite numbers.")
    if fault == _ik_kernels.NO_ROTATION:
        raise PlanningError(
            "The pose is no rigid motion: its upper left 3 × 3 must be a rotation and its last row 0 0 0 1."
        )
    raise PlanningError(
        f"A pose (4, 4) and a seed ({n},) are expected, but their shapes are {target.shape} and {seed.shape}."
    )
