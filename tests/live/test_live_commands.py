"""What clients send comes out as it went in, or is refused with a sentence."""

import numpy as np
import pytest

import longreach as lr
from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import GripperCommand
from longreach.errors import LongreachError, PlanningError
from longreach.geometry import se3
from longreach.io import messages
from longreach.live.protocol import commands, topics
from longreach.live.protocol.topics import TYPES


def test_a_twist_and_a_gripper_command_and_a_pose_come_out_as_they_went_in(thing, rng):
    twist = commands.twist(commands.twist_message(12.5, np.array([0.1, -0.2, 0.3])), thing)
    assert twist.stamp == 12.5
    assert np.array_equal(twist.base, [0.1, -0.2, 0.3])
    for wish in (GripperCommand("position", 0.4), GripperCommand("velocity", -1.0), GripperCommand("force", 20.0)):
        assert commands.gripper(commands.gripper_message(1.0, wish), thing) == wish
    for T in se3.exp(rng.uniform(-2.0, 2.0, (20, 6))):
        assert np.allclose(commands.tool(messages.tool_pose(TYPES, 1.0, T)), T, atol=1e-9)


def test_the_arms_joints_may_come_in_any_order(thing):
    names = thing.joint_names[thing.arm]
    message = messages.joint_state(TYPES, 1.0, names[::-1], velocity=0.1 * np.arange(6.0))
    command = commands.arm(message, thing)
    assert command.arm_mode == "velocity"
    assert np.array_equal(command.arm, 0.1 * np.arange(6.0)[::-1])
    assert commands.arm(messages.joint_state(TYPES, 1.0, names, np.ones(6)), thing).arm_mode == "position"


def test_a_trajectory_comes_out_as_it_went_in_through_cdr(thing, rng):
    plan = ConfigurationTrajectory(np.array([2.0, 3.0, 4.5]), rng.uniform(-0.3, 0.3, (3, 9)), thing.joint_names)
    payload = topics.EXECUTE.pack(messages.joint_trajectory(TYPES, 1.0, plan))
    again = commands.trajectory(topics.EXECUTE.unpack(payload), thing)
    assert np.allclose(again.stamps, [0.0, 1.0, 2.5])  # a message counts from its first point
    assert np.array_equal(again.q, plan.q)
    assert np.array_equal(again.velocities, plan.velocities)


def _joints(thing, values, names=None):
    return messages.joint_state(TYPES, 1.0, names or thing.joint_names[thing.arm], velocity=np.array(values))


def _positions(thing, values):
    return messages.joint_state(TYPES, 1.0, thing.joint_names[thing.arm], np.array(values))


def _twist(robot, vx, vy, omega, up=0.0):
    message = commands.twist_message(1.0, np.array([vx, vy, omega]))
    message.twist.linear.z = up
    return commands.twist(message, robot)


def _gripper(thing, mode, value):
    return commands.gripper(commands.gripper_message(1.0, GripperCommand(mode, value)), thing)


def _trajectory(thing, stamps, q, names=None):
    shape = (len(q), 9)
    plan = ConfigurationTrajectory(
        np.arange(float(len(q))), np.zeros(shape), names or thing.joint_names, np.zeros(shape)
    )
    message = messages.joint_trajectory(TYPES, 1.0, plan)
    for point, row in zip(message.points, q, strict=True):
        point.positions = np.array(row)
    for point, stamp in zip(message.points, stamps, strict=True):
        point.time_from_start.sec = stamp
    return message


@pytest.mark.parametrize(
    ("read", "sentence"),
    [
        (lambda thing: _twist(thing, np.nan, 0.0, 0.0), "finite"),
        (lambda thing: _twist(thing, 1e300, 0.0, 0.0), "finite"),
        (lambda thing: _twist(thing, 2.3, 0.0, 0.0), r"base_x may move at 1\.1 m/s; more than twice that is refused"),
        (lambda thing: _twist(thing, 0.0, 0.0, -4.1), "base_theta may move at 2 rad/s"),
        (lambda thing: _twist(thing, 0.1, 0.0, 0.0, up=0.1), "linear z"),
        (lambda thing: _twist(lr.load_robot("ur10"), 0.1, 0.0, 0.0), "ur10 has no base that drives"),
        (lambda thing: _gripper(thing, "position", 1.1), "position of the gripper must be from 0 to 1"),
        (lambda thing: _gripper(thing, "position", -0.1), "position of the gripper must be from 0 to 1"),
        (lambda thing: _gripper(thing, "velocity", -1.1), "velocity of the gripper must be from -1 to 1"),
        (lambda thing: _gripper(thing, "force", 61.0), "force of the gripper must be from -60 to 60"),
        (lambda thing: _gripper(thing, "force", np.nan), "finite"),
        (lambda thing: commands.arm(_joints(thing, [0.0] * 5 + [6.3]), thing), "wrist_3_joint may move at 3.14"),
        (lambda thing: commands.arm(_positions(thing, [0.0, 7.0, 0, 0, 0, 0]), thing), "shoulder_lift_joint must stay"),
        (lambda t: commands.trajectory(_trajectory(t, [0, 1], [[0.0] * 9, [3.0, *[0.0] * 8]]), t), "base_x may move"),
        (lambda t: commands.trajectory(_trajectory(t, [0, 9], [[0.0] * 9, [*[0.0] * 8, 7.0]]), t), "wrist_3_joint"),
        (lambda t: commands.trajectory(_trajectory(t, [0], [np.full(9, np.nan)]), t), "finite"),
        (lambda thing: commands.arm(_joints(thing, [0.0] * 5), thing), "each of its joints"),
        (lambda thing: commands.arm(_joints(thing, [np.inf] * 6), thing), "finite"),
        (lambda thing: commands.arm(_joints(thing, [0.0] * 6, ["a"] * 6), thing), "each of its joints"),
        (lambda thing: commands.gripper(_joints(thing, [0.0]), thing), "one number"),
        (lambda thing: commands.tool(messages.tool_pose(TYPES, 1.0, np.full((4, 4), np.nan))), "finite"),
        (lambda t: commands.trajectory(_trajectory(t, [0], [np.zeros(9)], tuple("abcdefghi")), t), "joints"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_with_a_sentence(thing, read, sentence):
    with pytest.raises(LongreachError, match=sentence):
        read(thing)


def test_twice_a_limit_is_left_to_the_gate():
    thing = lr.load_robot("thing")
    assert np.array_equal(_twist(thing, 2.2, -2.2, 4.0).base, [2.2, -2.2, 4.0])


@pytest.mark.parametrize(
    "T",
    [
        np.diag([1.0, 1.0, -1.0, 1.0]), np.diag([1.01, 1.01, 1.01, 1.0]), 2.0 * np.eye(4), np.eye(4)[::-1],
        np.full((4, 4), np.nan), np.eye(3), None, "pose", np.zeros((4, 4)), np.eye(4) + np.eye(4, k=1),
    ],
)  # fmt: skip
def test_a_pose_that_is_no_rigid_motion_is_refused(T):
    with pytest.raises(LongreachError, match=r"no rigid motion|numbers"):
        commands.rigid(T, "A pose")


def test_a_trajectory_whose_time_runs_backwards_is_refused(thing):
    with pytest.raises(PlanningError, match="increase"):
        commands.trajectory(_trajectory(thing, [1, 0], np.zeros((2, 9))), thing)
