"""Forward kinematics and Jacobian of the Thing's nine joints, beside pinocchio in the same run.

    OMP_NUM_THREADS=1 python benchmarks/kinematics.py

The peer is not installed with longreach. Make an environment for this benchmark and put both in it:
`pip install . pin`. Without pinocchio our own times are printed alone.

Bars: 0.7 µs a call with `out=`, 1.0 µs with fresh arrays, 3.0 ms for 10 000 configurations, on a machine where
pinocchio takes 1.06 µs a call; on another, what counts is the ratio. Rounds alternate, so that both meet the same
disturbances; the median round is printed, and the fastest.
"""

import statistics
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from longreach.io.robots import load_robot
from longreach.robot.manipulability import manipulability
from longreach.robot.mobile_manipulator import MobileManipulator

ROUNDS, CALLS, CONFIGURATIONS = 200, 500, 10_000
PINOCCHIO_CALL, PINOCCHIO_BATCH = 1.06, 18.9  # µs, ms: where the bars were set


def a_call(function: Callable[..., Any], *arguments: Any, **named: Any) -> Callable[[], float]:
    """Return a round: what one of CALLS calls takes [µs]."""

    def positional() -> float:
        began = time.perf_counter()
        for _ in range(CALLS):
            function(*arguments)
        return 1e6 * (time.perf_counter() - began) / CALLS

    def into() -> float:
        q, out = arguments[0], named["out"]
        began = time.perf_counter()
        for _ in range(CALLS):
            function(q, out=out)
        return 1e6 * (time.perf_counter() - began) / CALLS

    return into if named else positional


def timed(function: Callable[[], Any]) -> float:
    """Return what one call takes [ms]."""
    began = time.perf_counter()
    function()
    return 1e3 * (time.perf_counter() - began)


def pinocchio_rounds(robot: MobileManipulator, Q: np.ndarray) -> dict[str, Callable[[], float]]:
    """Return rounds of pinocchio on the very same chain, having seen that it gives the same Jacobian."""
    import pinocchio as pin  # type: ignore[import-not-found]

    model, parent = pin.Model(), 0
    for i, (F, slides) in enumerate(zip(robot.fixed, robot.prismatic, strict=False)):
        joint = pin.JointModelPZ() if slides else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, pin.SE3(F), robot.joint_names[i])
    tool = model.addFrame(pin.Frame("tool", parent, pin.SE3(robot.fixed[-1]), pin.FrameType.OP_FRAME))
    data, axes = model.createData(), pin.LOCAL_WORLD_ALIGNED
    jacobian, place = pin.computeFrameJacobian, pin.updateFramePlacement
    for q in Q[:100]:
        T, J = robot.forward_and_jacobian(q)
        np.testing.assert_allclose(jacobian(model, data, q, tool, axes), J, atol=1e-12)
        np.testing.assert_allclose(place(model, data, tool).homogeneous, T, atol=1e-12)
    T, J = np.empty((len(Q), 4, 4)), np.empty((len(Q), 6, robot.dof))

    def batch() -> None:
        for i, q in enumerate(Q):
            J[i] = jacobian(model, data, q, tool, axes)
            T[i] = place(model, data, tool).homogeneous

    return {"call": a_call(jacobian, model, data, Q[0], tool, axes), "batch": lambda: timed(batch)}


def main() -> None:
    robot = load_robot("thing").with_tool("flange")
    Q = np.random.default_rng(1).uniform(-3, 3, (CONFIGURATIONS, robot.dof))
    q, out = Q[0].copy(), (np.empty((4, 4)), np.empty((6, robot.dof)))
    rounds = {
        "out": a_call(robot.forward_and_jacobian, q, out=out),
        "fresh": a_call(robot.forward_and_jacobian, q),
        "ours batch": lambda: timed(lambda: robot.forward_and_jacobian_batch(Q)),
        "measure": lambda: timed(lambda: manipulability(robot, Q, "sqrt_kappa_over_m")),
    }
    peer = find_spec("pinocchio") is not None
    if peer:
        rounds |= pinocchio_rounds(robot, Q)
    for run in rounds.values():
        run()  # warm
    times: dict[str, list[float]] = {name: [] for name in rounds}
    for i in range(ROUNDS):
        for name, run in rounds.items():
            if i % 10 == 0 or name in ("out", "fresh", "call"):
                times[name].append(run())
    report = [
        ("FK + J, with out=", "out", "µs", 0.7, "call", PINOCCHIO_CALL),
        ("FK + J, fresh arrays", "fresh", "µs", 1.0, "call", PINOCCHIO_CALL),
        (f"FK + J, {CONFIGURATIONS} at once", "ours batch", "ms", 3.0, "batch", PINOCCHIO_BATCH),
    ]
    for what, ours, unit, bar, theirs, there in report:
        found, fastest = statistics.median(times[ours]), min(times[ours])
        line = f"{what:24s} {found:6.3f} {unit} (fastest {fastest:.3f}), bar {bar}"
        if peer:
            pinocchio = statistics.median(times[theirs])
            line += f"; pinocchio {pinocchio:.3f} {unit}: ratio {found / pinocchio:.3f}, bar {bar / there:.3f}"
        print(line)
    if not peer:
        print("pinocchio is not installed here (pip install pin), so there is nothing to compare with")
    per = statistics.median(times["measure"]) / CONFIGURATIONS * 1e3
    print(f"√(κ/M) with FK, J and gradient: {per:.2f} µs a configuration")


if __name__ == "__main__":
    main()
