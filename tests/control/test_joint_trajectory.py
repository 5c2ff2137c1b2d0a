"""The joint trajectory controller before a perfect robot, a stuck one, and one that is too slow."""

import numpy as np
import pytest

from longreach.control import joint_trajectory
from longreach.control.interpolation import sample, timed_points
from longreach.control.joint_trajectory import JointInput, JointTrajectoryConfig
from longreach.control.pid import PidConfig
from longreach.errors import ControlError

PERIOD = 0.008
GOAL = np.array([0.5, -0.3])


@pytest.fixture
def trajectory():
    points = np.array([[0.0, 0.0], [0.2, -0.2], GOAL])
    return timed_points(np.array([7.0, 7.5, 8.0]), points, joint_names=("shoulder", "elbow"))


def run(config, trajectory, obeys=1.0, q=(0.0, 0.0), duration=2.5):
    """The states and outputs of a robot that does part of what it is told."""
    state = joint_trajectory.follow(joint_trajectory.init(config, 100.0), trajectory)
    q, v, rows = np.array(q), np.zeros(2), []
    for k in range(round(duration / PERIOD)):
        state, out = joint_trajectory.step(state, JointInput(q, v), 100.0 + k * PERIOD)
        rows.append((state, out, q))
        v = obeys * (out.arm if out.mode == "velocity" else (out.arm - q) / PERIOD)
        q = q + v * PERIOD
    return rows


@pytest.mark.parametrize("command", ["velocity", "position"])
@pytest.mark.parametrize("degree", ["cubic", "quintic"])
def test_a_robot_that_obeys_reaches_the_goal_along_the_path(trajectory, command, degree):
    rows = run(JointTrajectoryConfig(command=command, degree=degree), trajectory)
    assert [rows[i][0].status for i in (0, 100, -1)] == ["running", "running", "reached"]
    np.testing.assert_allclose(rows[-1][2], GOAL, atol=1e-3)
    assert max(np.abs(out.error).max() for _, out, _ in rows) < 0.02
    reached = next(k for k, row in enumerate(rows) if row[0].status == "reached")
    assert 1.0 < reached * PERIOD < 1.5
    assert "The goal was reached 0." in rows[-1][0].reason


def test_the_reference_is_the_interpolated_trajectory(trajectory):
    for k, (_, out, _) in enumerate(run(JointTrajectoryConfig(), trajectory, duration=1.0)):
        np.testing.assert_allclose(out.reference, sample(trajectory, 7.0 + k * PERIOD)[0], atol=1e-9)


def test_an_error_at_the_start_is_made_good_by_the_gains(trajectory):
    rows = run(JointTrajectoryConfig(gains=PidConfig(p=(8.0,))), trajectory, q=(0.05, -0.05))
    assert rows[-1][0].status == "reached"
    assert np.abs(rows[60][1].error).max() < 0.01


def test_a_stuck_robot_violates_the_path_tolerance_and_then_stands(trajectory):
    rows = run(JointTrajectoryConfig(), trajectory, obeys=0.0)
    state, out, _ = rows[-1]
    assert state.status == "path tolerance violated"
    assert state.reason.startswith("elbow is 0.10")
    assert "0.1 are allowed" in state.reason
    np.testing.assert_array_equal(out.arm, 0.0)


def test_a_joint_of_which_nothing_is_known_violates_the_path_tolerance(trajectory):
    state = joint_trajectory.follow(joint_trajectory.init(JointTrajectoryConfig(), 0.0), trajectory)
    state, out = joint_trajectory.step(state, JointInput(np.array([0.0, np.nan]), np.zeros(2)), 0.1)
    assert state.status == "path tolerance violated"
    assert "elbow is nan off" in state.reason
    np.testing.assert_array_equal(out.arm, 0.0)


def test_a_slow_robot_exceeds_the_goal_time(trajectory):
    config = JointTrajectoryConfig(path_tolerance=(9.0,), gains=PidConfig(p=(0.1,)))
    state = run(config, trajectory, obeys=0.5)[-1][0]
    assert state.status == "goal time exceeded"
    assert "0.5" in state.reason
    assert "shoulder is 0." in state.reason


def test_a_robot_that_does_not_stand_still_has_not_reached_the_goal(trajectory):
    state = joint_trajectory.follow(joint_trajectory.init(JointTrajectoryConfig(), 0.0), trajectory)
    for now, status in ((1.1, "running"), (1.6, "goal time exceeded")):
        state, _ = joint_trajectory.step(state, JointInput(GOAL, np.array([0.1, 0.0])), now)
        assert state.status == status
    assert state.reason == "A joint does not stand still, 0.60 s after the end."


def test_a_tolerance_may_be_given_for_each_joint(trajectory):
    config = JointTrajectoryConfig(path_tolerance=(1.0, 0.05))
    assert run(config, trajectory, obeys=0.0)[-1][0].reason.startswith("elbow is 0.05")


def test_a_joint_that_is_too_slow_violates_its_tolerance_of_velocity(trajectory):
    config = JointTrajectoryConfig(path_tolerance=(10.0,), path_velocity_tolerance=(10.0, 0.1))
    state = run(config, trajectory, obeys=0.5)[-1][0]
    assert state.status == "path tolerance violated"
    assert state.reason.startswith("elbow is 0.1")
    assert "rad/s off, 0.1 are allowed" in state.reason
    assert run(config, trajectory)[-1][0].status == "reached"


def test_each_joint_may_have_a_speed_of_its_own_at_which_it_stands(trajectory):
    for still, status in (((0.2, 0.01), "reached"), ((0.01, 0.2), "running")):
        state = joint_trajectory.init(JointTrajectoryConfig(stopped_velocity=still), 0.0)
        state = joint_trajectory.follow(state, trajectory)
        assert joint_trajectory.step(state, JointInput(GOAL, np.array([0.1, 0.0])), 1.1)[0].status == status


def test_where_it_gave_up_it_stays_in_position_mode(trajectory):
    rows = run(JointTrajectoryConfig(command="position"), trajectory, obeys=0.0, q=(0.02, 0.0))
    np.testing.assert_array_equal(rows[-1][1].arm, [0.02, 0.0])


def test_without_a_trajectory_the_joints_stand_and_a_new_one_replaces_the_old(trajectory):
    state = joint_trajectory.init(JointTrajectoryConfig(), 0.0)
    state, out = joint_trajectory.step(state, JointInput(GOAL, np.zeros(2)), 0.1)
    assert state.status == "idle"
    np.testing.assert_array_equal(out.arm, 0.0)
    state = joint_trajectory.follow(state, trajectory, start=1.0)
    state, out = joint_trajectory.step(state, JointInput(np.zeros(2), np.zeros(2)), 0.2)
    assert state.status == "running"
    np.testing.assert_array_equal(out.arm, 0.0)  # not before its start


def test_numbers_that_do_not_fit_the_joints_are_refused(trajectory):
    state = joint_trajectory.init(JointTrajectoryConfig(gains=PidConfig(i=(1.0, 1.0, 1.0))), 0.0)
    with pytest.raises(ControlError, match=r"gains\.i has 3 numbers for 2 joints; give one, or one a joint\."):
        joint_trajectory.follow(state, trajectory)
    state = joint_trajectory.follow(joint_trajectory.init(JointTrajectoryConfig(), 0.0), trajectory)
    with pytest.raises(ControlError, match="A trajectory of 2 joints cannot move 6"):
        joint_trajectory.step(state, JointInput(np.zeros(6), np.zeros(6)), 0.0)
