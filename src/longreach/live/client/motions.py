"""Plans of a client, at rest at both ends: straight to a configuration, along a reference, the tool to a pose."""

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.control.interpolation import sample
from longreach.errors import PlanningError
from longreach.geometry import se3
from longreach.planning.planner import plan
from longreach.planning.problem import Problem
from longreach.planning.terms import Cost, Manipulability, NearSeed
from longreach.planning.terms_pose import ToolPose
from longreach.planning.timing import eased
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator

_PART = 0.8  # of what a joint can do is planned with: the rest is for correcting; ours
_SPEED, _TURN = 0.15, 0.5  # of the tool on its way to a pose [m/s], [rad/s]; ours
_WAYPOINTS = 60
_BASE, _NIMBLE = 30.0, 0.1  # by sqp: what a metre of the base costs beside a radian of a joint, and √(κ/M); ours
_ROOM = 1000.0  # a base has no end stops, its description only says where it is planned by itself [m]


def straight(
    robot: MobileManipulator, q: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"]
) -> ConfigurationTrajectory:
    """Return the way from q to another configuration (n,), all joints at once, as fast as a cubic may be.

    Raises:
        PlanningError: the goal is outside the joints' limits.
    """
    robot = roomy(robot)
    if robot.base.stop:  # the short way round
        goal = goal.copy()
        goal[2] = q[2] + np.remainder(goal[2] - q[2] + np.pi, 2 * np.pi) - np.pi
    outside = np.flatnonzero((goal < robot.lower) | (goal > robot.upper))
    if len(outside):
        i = int(outside[0])
        raise PlanningError(
            f"{robot.joint_names[i]} at {goal[i]:.3f} is outside its limits {robot.lower[i]:g} to {robot.upper[i]:g}."
        )
    away, limits = np.abs(goal - q), robot.limits
    # A cubic from rest to rest has 3/2 of its mean speed at most, and 6 of its way over the time squared.
    times = [1.5 * away / (_PART * limits.velocity), np.sqrt(6.0 * away / (_PART * limits.acceleration))]
    time = max(float(np.max(times)), 0.1)
    rest = np.zeros((2, robot.dof))
    return ConfigurationTrajectory(np.array([0.0, time]), np.stack([q, goal]), robot.joint_names, rest)


def along(
    robot: MobileManipulator, q: Float[np.ndarray, " n"], reference: Reference, method: str
) -> ConfigurationTrajectory:
    """Return the plan of a reference from q (n,), slower than that where the joints could not follow."""
    options = {"iterations": 20} if method == "task-priority" else {}
    return _slowed(robot, eased(plan(roomy(robot), reference, q, method=method, **options)))


def to_pose(
    robot: MobileManipulator, q: Float[np.ndarray, " n"], T: Float[np.ndarray, "4 4"], method: str
) -> ConfigurationTrajectory:
    """Return the plan that brings the tool straight to T_map_tool (4, 4).

    By sqp it ends where the arm is nimble and near q (n,), the base nearer than the arm; on the way there each joint is
    as near to a straight line as the tool's path allows.

    Raises:
        PlanningError: it cannot get there.
    """
    start = robot.forward(q)
    way = se3.difference(start, T)  # in the tool's own axes
    time = max(np.linalg.norm(T[:3, 3] - start[:3, 3]) / _SPEED, np.linalg.norm(way[3:]) / _TURN, 0.5)
    part = np.linspace(0.0, 1.0, _WAYPOINTS)
    tool = np.array([se3.retract(start, p * way) for p in part])
    tool[:, :3, 3] = start[:3, 3] + part[:, None] * (T[:3, 3] - start[:3, 3])
    reference = Reference(part * time, tool=tool)
    if method == "sqp":
        trajectory = _slowed(robot, eased(_to_nimble_end(roomy(robot), q, reference)))
    else:
        trajectory = along(robot, q, reference, method)
    missed = float(np.linalg.norm(robot.forward(trajectory.q[-1])[:3, 3] - T[:3, 3]))
    if missed > 0.01:
        raise PlanningError(f"The tool would end {missed:.3f} m from there; choose a pose that the robot can reach.")
    return trajectory


def what_is_left(
    robot: MobileManipulator, plan: ConfigurationTrajectory, q: Float[np.ndarray, " n"], progress: float
) -> ConfigurationTrajectory:
    """Return the rest of a plan of which a part, 0 to 1, is done, from rest at q (n,) straight back to where it was."""
    at = plan.stamps[0] + min(progress, 1.0) * plan.duration
    rows = plan.stamps > at
    there = sample(plan, np.array([at]))[0][0]
    back = straight(robot, q, there)
    if not rows.any():
        return back
    path = np.vstack([there, plan.q[rows]]) + (back.q[-1] - there)  # whole turns
    rest = eased(ConfigurationTrajectory(np.append(at, plan.stamps[rows]), path, plan.joint_names))
    stamps = np.append(back.stamps, back.duration + (rest.stamps[1:] - rest.stamps[0]))
    velocities = np.vstack([back.velocities, rest.velocities[1:]])
    return ConfigurationTrajectory(stamps, np.vstack([back.q, rest.q[1:]]), robot.joint_names, velocities)


def _to_nimble_end(
    robot: MobileManipulator, q: Float[np.ndarray, " n"], reference: Reference
) -> ConfigurationTrajectory:
    """Return the plan by sqp along the tool's path, from q (n,) exactly: problem (4.34) would begin elsewhere."""
    assert reference.tool is not None
    weights = np.ones(robot.dof)
    weights[robot.base] = _BASE
    costs: tuple[Cost, ...] = (NearSeed(q[None], weights),)
    if robot.dof - robot.arm.start >= 6:  # the arm alone moves the tool in all directions
        costs += (Manipulability(part="arm", weight=_NIMBLE),)
    last = Reference(np.zeros(1), tool=reference.tool[-1:])
    end = plan(robot, last, q, method="sqp", problem=Problem(costs, (ToolPose(),))).q[-1]
    part = (reference.stamps / reference.stamps[-1])[:, None]
    line = ConfigurationTrajectory(reference.stamps, q + part * (end - q), robot.joint_names)
    near = Problem((NearSeed(line.q, np.ones(robot.dof)),), (ToolPose(),))
    return plan(robot, reference, q, method="sqp", problem=near, initial=line)


def roomy(robot: MobileManipulator) -> MobileManipulator:
    """Return the robot with a base that may go anywhere."""
    lower, upper = robot.lower.copy(), robot.upper.copy()
    lower[robot.base], upper[robot.base] = -_ROOM, _ROOM
    return robot.with_limits(lower, upper)


def _slowed(robot: MobileManipulator, trajectory: ConfigurationTrajectory) -> ConfigurationTrajectory:
    """Return the same path, slower by as much as the limits of speed and acceleration ask for."""
    t = np.linspace(trajectory.stamps[0], trajectory.stamps[-1], 4 * len(trajectory))
    _, v, a = sample(trajectory, t)
    limits = robot.limits
    much = float(
        max(
            1.0,
            np.max(np.abs(v) / (_PART * limits.velocity)),
            np.sqrt(np.max(np.abs(a) / (_PART * limits.acceleration))),
        )
    )
    stamps = trajectory.stamps[0] + much * (trajectory.stamps - trajectory.stamps[0])
    return ConfigurationTrajectory(
        stamps, trajectory.q, trajectory.joint_names, trajectory.velocities / much, trajectory.reports
    )
