"""What a page plots of a run: errors, deviations, joint velocities against their limits, manipulability."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from longreach.evaluation import style
from longreach.robot.manipulability import manipulability
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.view.frame import Curve, Plot

JOINT_COLOURS = (style.BLUE, style.ORANGE, style.GREEN, style.VERMILION, style.PURPLE, style.SKY, style.BLACK)


def plots(
    robot: MobileManipulator,
    times: Float[np.ndarray, " n"],
    q: Float[np.ndarray, "n dof"],
    velocities: Float[np.ndarray, "n m"] | None,
    covariance: Float[np.ndarray, "n 3 3"] | None,
    poses: Mapping[str, Float[np.ndarray, "n 3"]],
    tools: Float[np.ndarray, "n 4 4"] | None,
) -> tuple[Plot, ...]:
    """Return the plots that there is something for."""
    found = []
    truth = poses.get("truth")
    if truth is not None:
        errors = [Curve("base", style.BLUE, 1e3 * _distance(poses["fused"], truth))]
        if covariance is not None:
            largest = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
            errors.append(Curve("3σ of the base, as stated", style.SKY, 3e3 * np.sqrt(np.maximum(largest, 0.0))))
        if tools is not None:
            off = np.linalg.norm(robot.forward(q)[:, :3, 3] - tools[:, :3, 3], axis=1)
            errors.append(Curve("tool", style.GREEN, 1e3 * off))
        found.append(plot("Error of the estimate [mm]", errors))
        if "wheels" in poses:
            found.append(plot("Error of the wheels alone [mm]", [
                Curve("wheels", style.ORANGE, 1e3 * _distance(poses["wheels"], truth))]))  # fmt: skip
    if covariance is not None:
        sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
        found.append(plot("Standard deviation of the base [mm]", [
            Curve("along", style.BLUE, 1e3 * sigma[:, 0]),
            Curve("across", style.ORANGE, 1e3 * sigma[:, 1])]))  # fmt: skip
        heading = [Curve("heading", style.BLUE, np.degrees(sigma[:, 2]))]
        found.append(plot("Standard deviation of the heading [°]", heading))
    if velocities is not None:
        found.append(speed_plot(robot, velocities))
        if robot.dof - robot.arm.start >= 6:
            m, _ = manipulability(robot, q, "m", "arm")
            found.append(plot("Manipulability of the arm √det(JJᵀ) [m³]", [Curve("M", style.GREEN, m)]))
    return tuple(found)


def speed_plot(robot: MobileManipulator, velocities: Float[np.ndarray, "n m"]) -> Plot:
    """Return how much of its limit each joint of the arm uses [%]."""
    part = 100.0 * velocities / robot.limits.velocity[robot.arm]
    names = [name.removesuffix("_joint").replace("_", " ") for name in robot.joint_names[robot.arm]]
    lines = [Curve(name, JOINT_COLOURS[i % 7], part[:, i]) for i, name in enumerate(names)]
    most = min(max(10.0, 1.1 * float(np.max(np.abs(part)))), 110.0)
    return Plot("Joint velocity, of its limit [%]", lines, -most, most)


def plot(title: str, lines: list[Curve]) -> Plot:
    """Return a plot from 0 to a little above the highest value."""
    highest = max(float(np.max(line.values)) for line in lines)
    return Plot(title, lines, 0.0, 1.1 * highest or 1.0)


def _distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a[:, :2] - b[:, :2], axis=1)
