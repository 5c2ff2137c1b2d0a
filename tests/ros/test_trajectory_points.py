"""A JointTrajectory message becomes our trajectory, or one sentence about what is wrong with it."""

import numpy as np
import pytest

from longreach.control.joint_trajectory import JointInput
from longreach.io import messages
from longreach.robot.chain import JointLimits
from longreach.ros import wire
from longreach.ros.trajectory_points import GoalError, trajectory_of

NAMES = ("a", "b")
LIMITS = JointLimits(*np.array([[-1.0, -2.0], [1.0, 2.0], [1.0, 1.0], [2.0, 2.0], [9.0, 9.0]]))
HERE = JointInput(np.array([0.1, 0.2]), np.array([0.01, 0.02]))


def message(points, names=NAMES, start=0.0):
    """points: (after [s], positions, velocities)."""
    types = wire.message_types()
    Point, Duration = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"]
    none = np.zeros(0)
    rows = [
        Point(np.array(q, dtype=float), np.array(v, dtype=float), none, none, Duration(*divmod(round(1e9 * t), 10**9)))
        for t, q, v in points
    ]
    return types["trajectory_msgs/msg/JointTrajectory"](messages.header(types, start, ""), list(names), rows)


def test_a_trajectory_begins_where_the_joints_are_and_ends_at_rest():
    trajectory, late = trajectory_of(message([(1.0, [0.5, 0.6], [])]), NAMES, LIMITS, HERE, 100.0)
    np.testing.assert_array_equal(trajectory.stamps, [0.0, 1.0])
    np.testing.assert_array_equal(trajectory.q, [[0.1, 0.2], [0.5, 0.6]])
    np.testing.assert_array_equal(trajectory.velocities[-1], 0.0)
    assert late == 0.0


def test_joints_may_come_in_any_order_and_the_start_may_be_given():
    given = message([(0.0, [0.2, 0.1], [0.0, 0.3]), (1.0, [0.6, 0.5], [0.0, 0.0])], ("b", "a"), start=101.0)
    trajectory, late = trajectory_of(given, NAMES, LIMITS, HERE, 100.0)
    np.testing.assert_array_equal(trajectory.q, [[0.1, 0.2], [0.5, 0.6]])
    np.testing.assert_array_equal(trajectory.velocities[0], [0.3, 0.0])
    assert late == -1.0


@pytest.mark.parametrize(
    ("given", "code", "sentence"),
    [
        (message([(1.0, [0.0, 0.0], [])], ("a", "c")), -2, "give it for a, b"),
        (message([]), -1, "no points"),
        (message([(1.0, [0.0], [])]), -1, "positions; give one a joint"),
        (message([(1.0, [0.0, 0.0], []), (1.0, [0.1, 0.1], [])]), -1, "must increase"),
        (message([(1.0, [0.0, np.nan], [])]), -1, "finite"),
        (message([(1.0, [0.0, 3.0], [])]), -1, "takes b to 3"),
        (message([(1.0, [0.0, 0.0], [])], start=10.0), -3, "ended 89.00 s ago"),
    ],
)
def test_what_cannot_be_followed_is_refused_with_its_code(given, code, sentence):
    with pytest.raises(GoalError, match=sentence) as error:
        trajectory_of(given, NAMES, LIMITS, HERE, 100.0)
    assert error.value.code == code


def test_the_types_of_the_action_are_those_of_control_msgs():
    # The checksums of control_msgs 1.5, which ROS compares before two nodes speak.
    known = {
        "ActionGoal": "cff5c1d533bf2f82dd0138d57f4304bb",
        "ActionResult": "c4fb3b000dc9da4fd99699380efcc5d9",
        "ActionFeedback": "d8920dc4eae9fc107e00999cce4be641",
    }
    gripper = {
        "ActionGoal": "aa581f648a35ed681db2ec0bf7a82bea",
        "ActionResult": "143702cb2df0f163c5283cedc5efc6b6",
        "ActionFeedback": "653dff30c045f5e6ff3feb3409f4558d",
    }
    for kind, md5 in gripper.items():
        assert wire.store().generate_msgdef(f"control_msgs/msg/GripperCommand{kind}", ros_version=1)[1] == md5
    for kind, md5 in known.items():
        assert wire.store().generate_msgdef(f"control_msgs/msg/FollowJointTrajectory{kind}", ros_version=1)[1] == md5
