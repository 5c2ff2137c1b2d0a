"""Inverse kinematics over four sets of poses, beside pink, mink, placo and a loop around pinocchio in the same run.

    OMP_NUM_THREADS=1 python benchmarks/inverse_kinematics.py --poses FOLDER [--peers 200]

FOLDER holds poses_{thing,thing1cm,ur10,ur10pi}.npz with `T` (n, 4, 4) and the seed `home`; what made T is not read.
The peers are not installed with longreach. Make an environment for this benchmark and put all in it:
`pip install . pin pin-pink mink placo daqp`. Those that are missing are left out.

Solved means: within 1e-4 m and 1e-4 rad by a DH forward kinematics that is written out here, inside the limits. Each
pose is one call, timed by itself. The peers take velocities, so each gets a loop: 20 steps a start, the first from
`home`, 20 more from random places between the limits, until its own error is below 1e-5; its joint limits are on.

Bars: median 0.015 ms (thing), 0.040 (ur10, ur10pi), 0.035 (thing1cm), 99th percentile 1 ms, 100 % solved, on a machine
where pinocchio takes 1.06 µs for FK + J; on another they are scaled by its time there, measured between the sets.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from longreach.io.robots import load_robot
from longreach.planning.inverse_kinematics import solve_ik
from longreach.robot.mobile_manipulator import MobileManipulator

ELBOW = np.array([np.pi, np.pi, 2.8, np.pi, np.pi, np.pi])
SETS = {  # limits, bar of the median [ms]
    "thing": (np.array([10.0] * 2 + [2 * np.pi] * 7), 0.015),
    "thing1cm": (np.array([0.01, 0.01, 0.1, *ELBOW]), 0.035),
    "ur10": (np.full(6, 2 * np.pi), 0.040),
    "ur10pi": (ELBOW, 0.040),
}
PINOCCHIO = 1.06  # µs
STEPS, STARTS, ENOUGH = 20, 21, 1e-5
DAMPING = 0.05  # of pink and mink, of their squared error
Search = Callable[[np.ndarray], tuple[np.ndarray, float]]  # T → q, time [s]


def table_pose(q: np.ndarray) -> np.ndarray:
    """Return the flange's pose (4, 4) by the products of Table B.1, the arm alone or with its base."""
    T = np.eye(4)
    if len(q) == 9:
        c, s = np.cos(q[2]), np.sin(q[2])
        T = np.array([[c, -s, 0, q[0]], [s, c, 0, q[1]], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        T = T @ np.array([[0, -1, 0, 0.27], [1, 0, 0, 0.01], [0, 0, 1, 0.653], [0, 0, 0, 1]])
    d = (0.1273, 0, 0, 0.163941, 0.1157, 0.0922)
    a, alpha = (0, -0.612, -0.5723, 0, 0, 0), (90, 0, 0, 90, -90, 0)
    for i, theta in enumerate(q[-6:]):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(np.radians(alpha[i])), np.sin(np.radians(alpha[i]))
        rows = [[c, -s * ca, s * sa, a[i] * c], [s, c * ca, -c * sa, a[i] * s], [0, sa, ca, d[i]], [0, 0, 0, 1]]
        T = T @ np.array(rows)
    return T


def is_solved(q: np.ndarray, T: np.ndarray, limits: np.ndarray) -> bool:
    found = table_pose(q)
    R = T[:3, :3].T @ found[:3, :3]
    angle = np.arctan2(np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]), np.trace(R) - 1)
    near = np.linalg.norm(found[:3, 3] - T[:3, 3]) < 1e-4 and angle < 1e-4
    return bool(near and np.all(np.abs(q) <= limits + 1e-12))


def ours(robot: MobileManipulator, home: np.ndarray) -> Search:
    solve_ik(robot, robot.forward(home), home)  # warm

    def search(T: np.ndarray) -> tuple[np.ndarray, float]:
        began = time.perf_counter()
        solution = solve_ik(robot, T, home)
        return solution.q, time.perf_counter() - began

    return search


def urdf(robot: MobileManipulator) -> str:
    """Return the chain as a URDF of bare links, so that every peer has the very same robot."""
    from scipy.spatial.transform import Rotation

    def origin(T: np.ndarray) -> str:
        numbers = [*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_euler("xyz")]
        return '<origin xyz="{!r} {!r} {!r}" rpy="{!r} {!r} {!r}"/>'.format(*map(float, numbers))

    inertia = '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
    n, lines = robot.dof, ['<robot name="chain">']
    for i in range(n + 2):
        lines.append(f'<link name="l{i}"><inertial><mass value="1"/>{inertia}</inertial></link>')
    for i in range(n):
        limit = f'<limit lower="{robot.lower[i]}" upper="{robot.upper[i]}" velocity="1e4" effort="1e4"/>'
        kind = "prismatic" if robot.prismatic[i] else "revolute"
        ends = f'<parent link="l{i}"/><child link="l{i + 1}"/>'
        lines.append(
            f'<joint name="j{i}" type="{kind}">{ends}{origin(robot.fixed[i])}<axis xyz="0 0 1"/>{limit}</joint>'
        )
    ends = f'<parent link="l{n}"/><child link="l{n + 1}"/>'
    return "\n".join([*lines, f'<joint name="tip" type="fixed">{ends}{origin(robot.fixed[n])}</joint>', "</robot>"])


def from_starts(
    robot: MobileManipulator,
    home: np.ndarray,
    aim: Callable[[np.ndarray], None],
    start: Callable[[np.ndarray], None],
    error: Callable[[], float],
    step: Callable[[], None],
    configuration: Callable[[], np.ndarray],
) -> Search:
    """Return the search that a peer's user would write around its steps."""
    rng = np.random.default_rng(1)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)

    def search(T: np.ndarray) -> tuple[np.ndarray, float]:
        seeds = [np.clip(home, robot.lower, robot.upper), *rng.uniform(lower, upper, (STARTS - 1, robot.dof))]
        began = time.perf_counter()
        aim(T)
        for seed in seeds:
            start(seed)
            for _ in range(STEPS):
                if error() < ENOUGH:
                    return configuration(), time.perf_counter() - began
                step()
        return configuration(), time.perf_counter() - began

    return search


def pinocchio_search(robot: MobileManipulator, home: np.ndarray) -> Search:
    """The loop of pinocchio's own examples, damped, with q cut to its limits after each step."""
    import pinocchio as pin  # type: ignore[import-not-found]

    model = pin.buildModelFromXML(urdf(robot))
    data, tool, now, identity = model.createData(), model.getFrameId(f"l{robot.dof + 1}"), {}, np.eye(6)

    def error() -> float:
        pin.framesForwardKinematics(model, data, now["q"])
        now["e"] = pin.log6(data.oMf[tool].actInv(now["T"])).vector
        return float(np.linalg.norm(now["e"]))

    def step() -> None:
        J = pin.computeFrameJacobian(model, data, now["q"], tool, pin.LOCAL)
        e = now["e"]
        dq = J.T @ np.linalg.solve(J @ J.T + (0.05 * e @ e + 1e-12) * identity, e)
        now["q"] = np.clip(now["q"] + dq, robot.lower, robot.upper)

    return from_starts(
        robot, home, lambda T: now.update(T=pin.SE3(T)), lambda q: now.update(q=q), error, step, lambda: now["q"]
    )


def pink_search(robot: MobileManipulator, home: np.ndarray) -> Search:
    import pink  # type: ignore[import-not-found]
    import pinocchio as pin  # type: ignore[import-not-found]

    model = pin.buildModelFromXML(urdf(robot))
    configuration = pink.Configuration(model, model.createData(), home)
    task = pink.tasks.FrameTask(f"l{robot.dof + 1}", position_cost=1.0, orientation_cost=1.0, lm_damping=DAMPING)
    limits = [pink.limits.ConfigurationLimit(model, config_limit_gain=1.0)]

    def step() -> None:
        v = pink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits, safety_break=False)
        configuration.update(np.clip(configuration.q + v, robot.lower, robot.upper))  # its end is a rounding outside

    def error() -> float:
        return float(np.linalg.norm(task.compute_error(configuration)))

    return from_starts(
        robot, home, lambda T: task.set_target(pin.SE3(T)), configuration.update, error, step,
        lambda: configuration.q.copy(),
    )  # fmt: skip


def mink_search(robot: MobileManipulator, home: np.ndarray) -> Search:
    import mink  # type: ignore[import-not-found]
    import mujoco  # type: ignore[import-not-found]

    spec = mujoco.MjSpec.from_string(urdf(robot))
    spec.compiler.fusestatic = False
    model = spec.compile()
    configuration = mink.Configuration(model)
    task = mink.FrameTask(f"l{robot.dof + 1}", "body", position_cost=1.0, orientation_cost=1.0, lm_damping=DAMPING)
    limits = [mink.ConfigurationLimit(model, gain=1.0)]

    def step() -> None:
        v = mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits)
        configuration.update(np.clip(configuration.q + v, robot.lower, robot.upper))

    def error() -> float:
        return float(np.linalg.norm(task.compute_error(configuration)))

    return from_starts(
        robot, home, lambda T: task.set_target(mink.SE3.from_matrix(T)), configuration.update, error, step,
        lambda: configuration.q.copy(),
    )  # fmt: skip


def placo_search(robot: MobileManipulator, home: np.ndarray) -> Search:
    import placo  # type: ignore[import-not-found]

    with tempfile.TemporaryDirectory() as folder:
        chain = placo.RobotWrapper(folder, placo.Flags.ignore_collisions, urdf(robot))
    solver = placo.KinematicsSolver(chain)
    solver.mask_fbase(True)
    solver.enable_joint_limits(True)
    task = solver.add_frame_task(f"l{robot.dof + 1}", np.eye(4))
    task.configure("tool", "soft", 1.0, 1.0)
    solver.add_regularization_task(1e-6)
    position, orientation, now = task.position(), task.orientation(), {"error": np.inf}

    def start(q: np.ndarray) -> None:
        now["error"] = np.inf  # it is told by a step, of where that began
        chain.state.q[7:] = q
        chain.update_kinematics()

    def step() -> None:
        solver.solve(True)
        now["error"] = max(position.error_norm(), orientation.error_norm())
        chain.state.q[7:] = np.clip(chain.state.q[7:], robot.lower, robot.upper)
        chain.update_kinematics()

    def aim(T: np.ndarray) -> None:
        task.T_world_frame = T

    return from_starts(robot, home, aim, start, lambda: now["error"], step, lambda: chain.state.q[7:].copy())


def pinocchio_microseconds() -> float | None:
    """Return what pinocchio takes for FK + J of the Thing, or None without it."""
    if find_spec("pinocchio") is None:
        return None
    import pinocchio as pin  # type: ignore[import-not-found]

    model = pin.buildModelFromXML(urdf(load_robot("thing").with_tool("flange")))
    data, tool, q, times = model.createData(), model.getFrameId("l10"), np.full(9, 0.3), []
    for _ in range(40):
        began = time.perf_counter()
        for _ in range(500):
            pin.computeFrameJacobian(model, data, q, tool, pin.LOCAL_WORLD_ALIGNED)
        times.append((time.perf_counter() - began) / 500)
    return 1e6 * float(np.median(times))


def measured(search: Search, T: np.ndarray, limits: np.ndarray, rounds: int = 1) -> tuple[float, float, float]:
    """Return the part that is solved [%], the median and the 99th percentile of the time [ms]."""
    found = [search(pose) for _ in range(rounds) for pose in T]
    solved = [is_solved(q, pose, limits) for (q, _), pose in zip(found, T, strict=False)]
    times = 1e3 * np.array([t for _, t in found])
    return 100.0 * float(np.mean(solved)), float(np.median(times)), float(np.percentile(times, 99))


PEERS: dict[str, tuple[str, Any]] = {
    "pinocchio loop": ("pinocchio", pinocchio_search),
    "pink": ("pink", pink_search),
    "mink": ("mink", mink_search),
    "placo": ("placo", placo_search),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=Path, required=True)
    parser.add_argument("--peers", type=int, default=200, help="poses a set that the peers get")
    arguments = parser.parse_args()
    for name, (limits, bar) in SETS.items():
        with np.load(arguments.poses / f"poses_{name}.npz") as poses:
            T, home = poses["T"], poses["home"]
        robot = load_robot("thing" if len(home) == 9 else "ur10").with_tool("flange").with_limits(-limits, limits)
        before = pinocchio_microseconds()
        solved, median, late = measured(ours(robot, home), T, limits, rounds=5)
        after = pinocchio_microseconds()
        line = f"{name:9s} longreach       {solved:6.2f} %, median {median:.4f} ms, p99 {late:.3f} ms; bar {bar:.3f} ms"
        if before and after:
            pinocchio = 0.5 * (before + after)
            line += f", here {bar * pinocchio / PINOCCHIO:.4f} ms (pinocchio's FK + J {pinocchio:.2f} µs)"
        print(line, flush=True)
        for peer, (module, make) in PEERS.items():
            if find_spec(module) is None:
                continue
            solved, theirs, late = measured(make(robot, home), T[: arguments.peers], limits)
            times = f"median {theirs:.4f} ms, p99 {late:.3f} ms; {theirs / median:.0f} × ours"
            print(f"{name:9s} {peer:15s} {solved:6.2f} %, {times}", flush=True)


if __name__ == "__main__":
    main()
