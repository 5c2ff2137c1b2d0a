"""The main path: a reference for tool and base becomes a trajectory of all joints."""

from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.errors import PlanningError
from longreach.planning.priority_planner import plan_by_task_priority
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator, turned_like

METHODS = ("task-priority", "sqp")


def plan(
    robot: MobileManipulator,
    reference: Reference,
    q0: Float[np.ndarray, " _"],
    method: str = "task-priority",
    iterations: int | None = None,
    **options: Any,
) -> ConfigurationTrajectory:
    """Plan configurations along a reference, one for each of its waypoints, from q0 (n,) [rad or m] on.

    Arguments: method: task-priority or sqp; iterations: at most so many, a waypoint where these are planned one after
        the other; the method's own number where None; options: of the method, see `plan_by_task_priority` and
        `sqp_planner.plan_by_sqp`.

    A heading is an angle: the reference's are continued, whole turns added, from that of q0.

    The trajectory's `reports` say of each task how far off it is along the way, and why where it is not met.

    Raises:
        PlanningError: there is no such method or option, or the reference or the start does not fit the robot.
    """
    check_method(method)
    if robot.description.base is not None and robot.description.base.kind == "ackermann":
        raise PlanningError(f"{robot.name} is steered like a car, and plans would turn it on the spot; none are made.")
    robot, reference = turned_like(robot, np.ravel(q0)), _turned_like(reference, np.ravel(q0))
    if iterations is not None:
        if iterations < 1:
            raise PlanningError(f"A plan needs at least one iteration a waypoint, not {iterations}.")
        options["iterations"] = iterations
    by_method = _by(method)
    if options:
        known = list(signature(by_method).parameters)[3:]
        unknown = sorted(options.keys() - set(known))
        if unknown:
            raise PlanningError(f"Plans by {method} have no option {unknown[0]!r}; they have {', '.join(known)}.")
    return by_method(robot, reference, q0, **options)


def _turned_like(reference: Reference, q0: np.ndarray) -> Reference:
    """Return the reference with continuous headings, the first the nearest to that of q0: a heading is an angle."""
    if reference.base is None or len(q0) < 3 or not np.isfinite(q0[2]):
        return reference
    base = reference.base.copy()
    base[:, 2] = np.unwrap(base[:, 2])
    base[:, 2] += 2 * np.pi * np.round((q0[2] - base[0, 2]) / (2 * np.pi))
    return reference if np.array_equal(base, reference.base) else replace(reference, base=base)


def check_method(method: str) -> None:
    """Raise a PlanningError where there is no such method."""
    if method not in METHODS:
        raise PlanningError(f"There is no method {method!r}; there is {', '.join(METHODS)}.")


def _by(method: str) -> Callable[..., ConfigurationTrajectory]:
    if method == "task-priority":
        return plan_by_task_priority
    from longreach.planning.sqp_planner import plan_by_sqp  # its solvers take time to import

    return plan_by_sqp
