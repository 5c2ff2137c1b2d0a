"""The dual trajectory by task priority, beside pink, mink and placo in the same run.

    OMP_NUM_THREADS=1 python benchmarks/task_priority.py --poses FOLDER

FOLDER holds dual.npz: tool poses `T` (200, 4, 4), base targets `B` (200, 3), the start `home`. The peers are not
installed with longreach. Make an environment for this benchmark and put all in it:
`pip install . pin pin-pink mink placo daqp`. Those that are missing are left out.

The peers weigh tasks against each other where longreach ranks them: tool and base at the same cost, and where the base
cannot be had (amplitude 1.2 m) the base at a tenth. Each of theirs is a loop over waypoints around one step of its own,
with its joint limits on; ours is one call of `plan`. Times are medians over the runs of the whole trajectory.

Bars: one iteration a waypoint 1.0 ms at a tool error of 3.7e-5 m; converged 3 ms at 1e-12 m (base 1e-9 m, orientation
1e-9 rad); amplitude 1.2 m: tool 1 mm and 1e-3 rad, largest joint step 0.2 rad, mean base error 0.13 m. Of a machine
where pinocchio takes 1.06 µs for FK + J; on another times are scaled by its time there.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from inverse_kinematics import PINOCCHIO, pinocchio_microseconds, urdf

import longreach as lr
from longreach.geometry import se2, se3
from longreach.planning.reference import dual_trajectory
from longreach.robot.mobile_manipulator import MobileManipulator

Follow = Callable[[lr.Reference, np.ndarray, int, float], np.ndarray]  # reference, home, iterations, base cost → Q
CONVERGED = 1e-12


def base_in_space(pose: np.ndarray) -> np.ndarray:
    x, y, theta = pose
    return se3.exp(np.array([0, 0, 0, 0, 0, theta])) + np.array([[0, 0, 0, x], [0, 0, 0, y], [0] * 4, [0] * 4])


def ours(robot: MobileManipulator) -> Follow:
    return lambda reference, home, iterations, _: lr.plan(robot, reference, home, iterations=iterations).q


def pink_follow(robot: MobileManipulator) -> Follow:
    import pink  # type: ignore[import-not-found]
    import pinocchio as pin  # type: ignore[import-not-found]

    model = pin.buildModelFromXML(urdf(robot))
    limits = [pink.limits.ConfigurationLimit(model, config_limit_gain=1.0)]
    tool, names = f"l{robot.dof + 1}", ("l3",)

    def follow(reference: lr.Reference, home: np.ndarray, iterations: int, cost: float) -> np.ndarray:
        configuration = pink.Configuration(model, model.createData(), home)
        tasks = [pink.tasks.FrameTask(tool, 1.0, 1.0), *(pink.tasks.FrameTask(name, cost, cost) for name in names)]
        Q = []
        for T, pose in zip(reference.tool, reference.base, strict=True):
            tasks[0].set_target(pin.SE3(T))
            tasks[1].set_target(pin.SE3(base_in_space(pose)))
            for _ in range(iterations):
                if iterations > 1 and all(np.linalg.norm(t.compute_error(configuration)) < CONVERGED for t in tasks):
                    break
                v = pink.solve_ik(configuration, tasks, 1.0, "daqp", limits=limits, safety_break=False)
                configuration.update(np.clip(configuration.q + v, robot.lower, robot.upper))
            Q.append(configuration.q.copy())
        return np.array(Q)

    return follow


def mink_follow(robot: MobileManipulator) -> Follow:
    import mink  # type: ignore[import-not-found]
    import mujoco  # type: ignore[import-not-found]

    spec = mujoco.MjSpec.from_string(urdf(robot))
    spec.compiler.fusestatic = False
    model = spec.compile()
    limits = [mink.ConfigurationLimit(model, gain=1.0)]

    def follow(reference: lr.Reference, home: np.ndarray, iterations: int, cost: float) -> np.ndarray:
        configuration = mink.Configuration(model)
        configuration.update(home)
        tasks = [mink.FrameTask(f"l{robot.dof + 1}", "body", 1.0, 1.0), mink.FrameTask("l3", "body", cost, cost)]
        Q = []
        for T, pose in zip(reference.tool, reference.base, strict=True):
            tasks[0].set_target(mink.SE3.from_matrix(T))
            tasks[1].set_target(mink.SE3.from_matrix(base_in_space(pose)))
            for _ in range(iterations):
                if iterations > 1 and all(np.linalg.norm(t.compute_error(configuration)) < CONVERGED for t in tasks):
                    break
                v = mink.solve_ik(configuration, tasks, 1.0, "daqp", limits=limits)
                configuration.update(np.clip(configuration.q + v, robot.lower, robot.upper))
            Q.append(configuration.q.copy())
        return np.array(Q)

    return follow


def placo_follow(robot: MobileManipulator) -> Follow:
    import placo  # type: ignore[import-not-found]

    with tempfile.TemporaryDirectory() as folder:
        chain = placo.RobotWrapper(folder, placo.Flags.ignore_collisions, urdf(robot))

    def follow(reference: lr.Reference, home: np.ndarray, iterations: int, cost: float) -> np.ndarray:
        solver = placo.KinematicsSolver(chain)
        solver.mask_fbase(True)
        solver.enable_joint_limits(True)
        tasks = [solver.add_frame_task(name, np.eye(4)) for name in (f"l{robot.dof + 1}", "l3")]
        tasks[0].configure("tool", "soft", 1.0, 1.0)
        tasks[1].configure("base", "soft", cost, cost)
        solver.add_regularization_task(1e-12)
        parts = [part for task in tasks for part in (task.position(), task.orientation())]
        chain.state.q[7:] = home
        chain.update_kinematics()
        Q = []
        for T, pose in zip(reference.tool, reference.base, strict=True):
            tasks[0].T_world_frame, tasks[1].T_world_frame = T, base_in_space(pose)
            for _ in range(iterations):
                solver.solve(True)
                chain.update_kinematics()
                if iterations > 1 and max(part.error_norm() for part in parts) < 1e-6:  # of before this step
                    break
            Q.append(chain.state.q[7:].copy())
        return np.array(Q)

    return follow


def tell(name: str, follow: Follow, robot: MobileManipulator, reference: lr.Reference, home: np.ndarray,
         iterations: int, cost: float, runs: int) -> None:  # fmt: skip
    times = []
    try:
        Q = follow(reference, home, iterations, cost)
        for _ in range(runs):
            began = time.perf_counter()
            follow(reference, home, iterations, cost)
            times.append(time.perf_counter() - began)
    except Exception as error:
        print(f"  {name:10s} raises {type(error).__name__}")
        return
    tool = se3.difference(reference.tool, robot.forward(Q))
    base = se2.difference(reference.base, Q[:, :3])
    far = np.linalg.norm(base[:, :2], axis=1)
    off, turned = (np.linalg.norm(part, axis=1).max() for part in (tool[:, :3], tool[:, 3:]))
    print(
        f"  {name:10s} {1e3 * np.median(times):8.3f} ms; at most: tool {off:.2e} m "
        f"{turned:.1e} rad, base {far.max():.1e} m (mean {far.mean():.4f}), "
        f"joint step {np.abs(np.diff(Q, axis=0)).max():.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=Path, required=True)
    parser.add_argument("--runs", type=int, default=101)
    options = parser.parse_args()
    problem = np.load(options.poses / "dual.npz")
    robot, home = lr.load_robot("thing").with_tool("flange"), problem["home"]
    shared = lr.Reference(np.linspace(0.0, 20.0, len(problem["T"])), tool=problem["T"], base=problem["B"])
    wide = dual_trajectory(robot.forward(home), amplitude=1.2)
    methods = {"longreach": ours(robot)}
    for name, make in {"pink": pink_follow, "mink": mink_follow, "placo": placo_follow}.items():
        if find_spec(name) is None:
            print(f"{name} is not installed here: left out.")
        else:
            methods[name] = make(robot)
    for title, reference, iterations, cost in (
        ("one iteration a waypoint (bar 1.0 ms, tool 3.7e-5 m)", shared, 1, 1.0),
        ("converged (bar 3 ms, tool 1e-12 m)", shared, 20, 1.0),
        ("base amplitude 1.2 m (bar 1e-3 m, 1e-3 rad, mean base 0.13 m, step 0.2)", wide, 20, 0.1),
    ):
        speed = pinocchio_microseconds()
        scale = (
            "" if speed is None else f"; pinocchio's FK + J takes {speed:.2f} µs, {speed / PINOCCHIO:.2f} of the bars'"
        )
        print(f"{title}{scale}")
        for name, follow in methods.items():
            tell(name, follow, robot, reference, home, iterations, cost, options.runs if name == "longreach" else 3)


if __name__ == "__main__":
    main()
