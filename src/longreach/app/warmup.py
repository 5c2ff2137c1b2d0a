"""Compile kernels before they are needed, and say so: once on a machine, and again only what a new version changed."""

import hashlib
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

import longreach
from longreach.kernels import cache_root, source_hash

# Each room imports what it runs when it is compiled; who finds all compiled loads none of it.

Progress = Callable[[str, float], None]


def warm_up(progress: Progress | None = None, *rooms: str) -> Path:
    """Run each kernel of the rooms named (all: of every one) on something small, unless that was done before.

    Rooms are compiled side by side, in processes of their own: that is most of what a first run waits for.
    Returns the folder of compiled kernels.
    """
    tell = progress or (lambda stage, fraction: None)
    version = _version()
    marks = {room: cache_root() / f"warm-{room}-{version}" for room in rooms or ALL}
    cold = [room for room, mark in marks.items() if not mark.is_file()]
    if not cold:
        return cache_root()
    from joblib import Parallel, delayed

    stage = f"compiling {', '.join(cold)} (first run only)"
    tell(stage, 0.0)
    beside = threading.current_thread() is not threading.main_thread()  # who is not to be held up by the compiler
    processes = 1 if len(cold) == 1 and not beside else -1
    jobs = Parallel(n_jobs=processes, return_as="generator_unordered")(delayed(_compile)(room) for room in cold)
    for done, room in enumerate(jobs, 1):
        marks[str(room)].touch()
        tell(stage, done / len(cold))
    return cache_root()


def _compile(room: str) -> str:
    ROOMS[room]()
    return room


def _version() -> str:
    """Return a hash over all kernel files, in a form that names a file."""
    files = sorted(Path(longreach.__file__).parent.rglob("*kernels.py"))
    return hashlib.sha256("".join(source_hash(file) for file in files).encode()).hexdigest()[:16]


def _estimation() -> None:
    from longreach.app.configuration import EstimateConfig
    from longreach.app.estimate import estimate
    from longreach.io.config import load_description
    from longreach.measurement import PoseMeasurement
    from longreach.sim.kinematic import make_recording

    thing = load_description("thing")
    recording = make_recording(thing, duration=1.0, lidar_rate=10.0, beams=90)
    estimate(recording, thing, EstimateConfig(sources=("wheels", "imu")))  # while another process may compile _scans
    fix = PoseMeasurement(0.5, np.zeros(3), np.eye(3), source="fixes")
    estimate(recording.replace(fixes=(fix,)), thing, EstimateConfig())


def _scans() -> None:
    from longreach.io.config import load_description
    from longreach.odometry.lidar import lidar_odometry
    from longreach.sim.kinematic import make_recording

    recording = make_recording(load_description("thing"), duration=1.0, lidar_rate=10.0, beams=90)
    lidar_odometry(recording.scans, recording.mounts[recording.scans[0].frame])


def _kinematics() -> None:
    from longreach.geometry import se3, so3
    from longreach.io.robots import load_robot
    from longreach.measurement import frozen_array
    from longreach.planning.inverse_kinematics import all_solutions, solve_ik
    from longreach.robot.manipulability import manipulability

    thing = load_robot("thing")
    q = thing.home
    frozen = frozen_array(np.stack([q, q]), (2, None), "two")  # as trajectories hold them
    for rows in (np.stack([q, q]), frozen):
        thing.forward(rows)
        thing.forward(rows[0])
        thing.forward_and_jacobian(rows[0])
        thing.forward_and_jacobian_batch(rows)
    thing.hessian(q)
    manipulability(thing, q)
    solve_ik(thing, thing.forward(q), q)
    all_solutions(thing, thing.forward(q))
    se3.retract(thing.forward(q), se3.right_jacobian(se3.log(thing.forward(q)))[0])
    so3.log(so3.exp(np.zeros(3)))


def _task_priority() -> None:
    from longreach.io.robots import load_robot
    from longreach.planning.planner import plan
    from longreach.planning.reference import dual_trajectory
    from longreach.robot.manipulability import manipulability

    thing = load_robot("thing")
    plan(thing, dual_trajectory(thing.forward(thing.home), waypoints=3), thing.home)
    manipulability(thing, np.stack([thing.home, thing.home]))


def _sqp() -> None:
    from longreach.io.robots import load_robot
    from longreach.planning.obstacles import Disc
    from longreach.planning.planner import plan
    from longreach.planning.reference import dual_trajectory
    from longreach.planning.terms_clearance import base_clearance
    from longreach.planning.thesis_problem import thesis_problem

    thing = load_robot("thing")
    reference = dual_trajectory(thing.forward(thing.home), waypoints=5)
    for coupled in (True, False):
        plan(thing, reference, thing.home, method="sqp", coupled=coupled)
    post = base_clearance(0.5, (Disc(thing.home[:2] + np.array([3.0, 3.0]), 0.1),))
    plan(thing, reference, thing.home, method="sqp", problem=thesis_problem().adding(post))


def _space() -> None:
    from longreach.estimation.spatial.batch import estimate_in_space
    from longreach.spatial_measurement import SpatialRecording, TwistReading
    from longreach.spatial_settings import SensorSettings, SpatialSettings

    mask = (False,) * 6 + (True,) * 3 + (False,) * 6
    settings = SpatialSettings((SensorSettings("twist0", "twist", "twist", mask),))
    readings = [TwistReading(0.1 * i, np.zeros(6), np.eye(6), "", "twist0") for i in range(3)]
    estimate_in_space(SpatialRecording("none", tuple(readings), mounts={"": np.eye(4)}), settings)


def _control() -> None:
    from longreach.configuration import ConfigurationTrajectory
    from longreach.control import base_velocity, interpolation, obstacles, safety, safety_checks, safety_config
    from longreach.control.hardware import Command
    from longreach.io.robots import load_robot
    from longreach.sim.kinematic_config import KinematicConfig
    from longreach.sim.kinematic_robot import KinematicRobot

    thing = load_robot("thing")
    robot = KinematicRobot(thing, config=KinematicConfig(present=("joints", "lidar")))
    gate = safety.init(safety_config.limits_of(robot.capabilities), 0.0, thing.home[thing.arm], thing)
    base = base_velocity.init(base_velocity.BaseVelocityConfig(), 0.0)
    ahead = np.array([0.5, 0.0, 0.0])
    two = ConfigurationTrajectory(np.array([0.0, 1.0]), np.stack([thing.home, thing.home]))
    for mode in ("velocity", "position", "velocity"):
        robot.advance(0.06)
        (q, v, _), now = interpolation.sample(two, robot.stamp), robot.stamp
        base, twist = base_velocity.step(base, np.zeros(3), now)
        arm = q[thing.arm] if mode == "position" else v[thing.arm]
        gate, sent = safety.step(gate, Command(now, arm, mode, twist), robot.read(), safety_checks.Health((), now), now)
        robot.write(sent)
    assert gate.obstacles is not None
    obstacles.limited(gate.obstacles, ahead, np.ones(3))
    obstacles.met_by(gate.obstacles, two)


def _mapping() -> None:
    from longreach.mapping.map_file import Map, Session
    from longreach.mapping.occupancy import render
    from longreach.mapping.pose_graph import Edges, PoseGraph
    from longreach.mapping.solver import optimize, relative_covariances
    from longreach.measurement import LaserScan

    ends = np.array([0, 1, 0]), np.array([1, 2, 2])
    edges = Edges(*ends, np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.1, 0.0, 0.0]]), np.stack([np.eye(3)] * 3))
    solved = optimize(PoseGraph(np.zeros((3, 3)), edges[:2], edges[2:]))
    relative_covariances(solved, *ends)
    scans = tuple(LaserScan(0.0, np.ones(3), 0.0, 0.1) for _ in range(3))
    session = Session("warm", "none", {"laser": np.eye(4)})
    render(Map(solved.graph, solved.weights, scans, np.zeros((3, 3)), np.zeros(3, dtype=int), (session,)))
    _loop()


def _loop() -> None:
    """Close a loop in a box of walls, to and fro."""
    from longreach.mapping import mapper
    from longreach.mapping.mapper import PathRow
    from longreach.mapping.refinement import refined
    from longreach.measurement import LaserScan
    from longreach.sim.room import box, cast

    x = np.concatenate([np.arange(0.0, 6.0, 0.5), np.arange(6.0, -0.1, -0.5)])
    poses = np.stack([x, 0.0 * x, 0.0 * x], axis=1)
    ranges = cast(box(3.0, 1.0, 10.0, 6.0, 0.1), poses, -np.pi + 0.07 * np.arange(90))
    rows = [PathRow(float(k), pose, (0.01 * k + 1e-3) * np.eye(3)) for k, pose in enumerate(poses)]
    scans = [LaserScan(float(k), r, -np.pi, 0.07) for k, r in enumerate(ranges)]
    state = mapper.settled(mapper.step(mapper.init(np.eye(4)), scans, rows))
    refined(state.keyframes, state.poses, state.graph.graph.closures)  # type: ignore[union-attr]


def _sim() -> None:
    from longreach.io.robots import load_robot
    from longreach.sim.monte_carlo import drive_many

    drive_many(load_robot("thing"), np.zeros((1, 1, 3)))
    _kinematic()
    _physics()


def _kinematic() -> None:
    _let_live("kinematic")


def _physics() -> None:
    from longreach.errors import ConfigError

    with suppress(ConfigError):  # MuJoCo need not be installed
        _let_live("sim")


def _let_live(kind: str) -> None:
    from longreach.app.operated import simulated
    from longreach.control.hardware import Command
    from longreach.io.robots import load_robot

    robot = simulated(kind, load_robot("thing"), "laboratory", 0)
    robot.write(Command(0.0, np.zeros(6), base=np.zeros(3)))
    robot.advance(0.06)
    robot.read()


ROOMS: Mapping[str, Callable[[], None]] = {
    "scans": _scans,
    "estimation": _estimation,
    "estimation in space": _space,
    "kinematics": _kinematics,
    "task priority": _task_priority,
    "sqp": _sqp,
    "control": _control,
    "mapping": _mapping,
    "sim": _sim,
    "kinematic": _kinematic,
    "physics": _physics,
}
ALL = tuple(room for room in ROOMS if room not in ("kinematic", "physics"))  # those are parts of sim
