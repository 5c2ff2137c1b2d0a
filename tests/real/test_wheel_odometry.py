"""Wheels alone on real logs: the known drift, and a covariance of the right size from one set of numbers."""

import bz2
from importlib.resources import files

import jaxtyping
import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from longreach.evaluation.alignment import align_pairs, associate
from longreach.geometry import se2
from longreach.measurement import Odometry, WheelTicks
from longreach.odometry import wheel
from longreach.odometry.dead_reckoning import integrate
from longreach.odometry.wheel import wheel_odometry
from longreach.robot.description import RobotDescription
from longreach.trajectory import PoseTrajectory, monotone_clock


def described(name):
    text = files("longreach.robot").joinpath("descriptions", f"{name}.yaml").read_text(encoding="utf-8")
    return RobotDescription.model_validate(yaml.safe_load(text))


def ate(path, truth):
    pairs, _ = align_pairs(associate(path, truth))
    return np.sqrt(np.mean(np.sum((pairs.estimate - pairs.truth)[:, :2] ** 2, axis=1)))


def seconds(message):
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def polimi(path):
    """Wheels and truth of a bag, read without the package's reader."""
    wheels, stamps, poses = [], [], []
    with AnyReader([path]) as bag:
        for connection, _, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            if connection.topic == "/wheel_states":
                wheels.append(WheelTicks(seconds(message), message.position))
            elif connection.topic == "/robot/pose":
                p, q = message.pose.position, message.pose.orientation
                stamps.append(seconds(message))
                heading = np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
                poses.append([p.x, p.y, heading])
    return wheels, PoseTrajectory(np.array(stamps), np.array(poses))


@pytest.mark.parametrize(("bag", "bound"), [("bag1.bag", 0.102), ("bag3.bag", 0.210)])
def test_nominal_parameters_give_the_known_error_on_polimi(data, bag, bound):
    wheels, truth = polimi(data / "polimi" / bag)
    found = wheel_odometry(wheels, described("polimi"))
    assert (found.breaks, found.refused) == (0, 0)
    path = integrate(found.measurements, [w.stamp for w in wheels])
    assert bound - 0.001 < ate(path, truth) <= bound
    # Nominal wheels are 5 % off, and yet they agree with each other about what they do.
    assert np.sqrt(np.mean(found.slip**2)) < 0.01


def brenner(data):
    motors = [line.split() for line in (data / "brenner" / "robot4_motors.txt").read_text().splitlines()]
    return [WheelTicks(float(row[1]) / 1e3, np.array([row[2], row[6]], dtype=float)) for row in motors]


def test_brenners_tracks_give_the_known_error(data):
    wheels = brenner(data)
    rows = [line.split()[1:] for line in (data / "brenner" / "robot4_reference.txt").read_text().splitlines()]
    reference = np.array(rows, dtype=float) / 1e3
    poses = np.column_stack([reference[:, 1:3], np.zeros(len(reference))])
    truth = PoseTrajectory(reference[:, 0], poses, has_heading=False)
    found = wheel_odometry(wheels, described("brenner"))
    assert found.breaks == 0
    path = integrate(found.measurements, [w.stamp for w in wheels])
    assert ate(path, truth) == pytest.approx(0.427, abs=0.005)  # 0.429, associated in another way


def carmen(path):
    """Wheels of a CARMEN log with a clock that never runs backwards, and the row of each stamp as recorded."""
    with bz2.open(path, "rt") as lines:
        rows = [line.split() for line in lines if line.startswith("FLASER ")]
    values = np.array([row[int(row[1]) + 5 : int(row[1]) + 9] for row in rows], dtype=float)
    clock = monotone_clock(values[:, 3]).tolist()
    wheels = [Odometry(stamp, pose=pose) for stamp, pose in zip(clock, values[:, :3], strict=True)]
    return wheels, {stamp: i for i, stamp in enumerate(values[:, 3].tolist())}


# On ACES the relations were laid on the wheels' own 5 cm grid, so that x says nothing of the wheels.
@pytest.mark.parametrize(("name", "axes"), [("intel", [0, 1, 2]), ("aces", [1, 2])])
def test_the_covariance_is_of_the_right_size_on_short_relations(data, name, axes):
    wheels, row_of = carmen(data / name / f"{name}.clf.bz2")
    found = wheel_odometry(wheels, described(name))
    assert (found.breaks, found.refused) == (0, 0)
    ending = {m.stamp: m for m in found.measurements}
    nees = []
    for t1, t2, x, y, *_, yaw in np.loadtxt(data / name / f"{name}.relations").tolist():
        i, j = row_of[t1], row_of[t2]
        if not (abs(t2 - t1) <= 5.0 and i < j):
            continue
        stamps = [w.stamp for w in wheels[i : j + 1]]
        path = integrate([ending[s] for s in stamps[1:]], stamps)
        error = se2.difference(path.poses[-1], np.array([x, y, yaw]))[axes]
        P = (path.covariance[-1] + np.diag([0.01, 0.01, 0.0]) ** 2)[np.ix_(axes, axes)]  # laid by eye, to a centimetre
        nees.append(error @ np.linalg.solve(P, error) / len(axes))
    assert len(nees) > 1000
    assert 0.8 < np.sqrt(np.mean(nees)) < 1.2


def test_the_covariance_is_of_the_right_size_over_three_seconds_of_polimi(data):
    nees = []
    for bag in ("bag1.bag", "bag3.bag"):
        wheels, truth = polimi(data / "polimi" / bag)
        found = wheel_odometry(wheels, described("polimi")).measurements
        for k in range(0, len(found) - 150, 150):
            stamps = [found[k].stamp_reference, *(m.stamp for m in found[k : k + 150])]
            path = integrate(found[k : k + 150], stamps)
            ends, known = truth.at(np.array([stamps[0], stamps[-1]]), longest_gap=0.1)
            if known.all():
                error = se2.difference(path.poses[-1], se2.between(ends[0], ends[1]))
                nees.append(error @ np.linalg.solve(path.covariance[-1], error) / 3)
    assert len(nees) > 30
    assert 0.8 < np.sqrt(np.mean(nees)) < 1.6  # its nominal wheels are 5 % off


def bits(steps):
    return [
        (m.stamp_reference, m.stamp, m.pose.tobytes(), m.covariance.tobytes(), m.reading_covariance.tobytes())
        for m in steps
    ]


@pytest.fixture
def shapes_unchecked():
    """Turn the shape checks off: for a log fed record by record they take longer than what they check."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.usefixtures("shapes_unchecked")
@pytest.mark.parametrize("log", ["intel", "aces", "fr079", "csail", "bag1.bag", "bag3.bag", "brenner"])
def test_records_one_by_one_and_in_blocks_give_the_steps_of_the_whole_log(data, log, rng):
    if log.endswith(".bag"):
        robot, wheels = "polimi", polimi(data / "polimi" / log)[0]
    elif log == "brenner":
        robot, wheels = log, brenner(data)
    else:
        path = data / log / f"{log}.clf.bz2"
        if not path.is_file():
            pytest.skip(f"there is no {log} log")
        robot, wheels = log if log == "intel" else "aces", carmen(path)[0]
    whole = wheel_odometry(wheels, described(robot))
    assert whole.breaks == 0
    lengths = rng.integers(1, 50, len(wheels)).tolist()
    for blocks in ([1] * len(wheels), lengths):
        state, steps, at = wheel.init(described(robot)), [], 0
        for length in blocks:
            state, found = wheel.step(state, wheels[at : at + length])
            steps += found
            at += length
        assert bits(steps) == bits(whole.measurements)
        assert (state.breaks, state.refused, state.late) == (0, 0, 0)
