"""What clients send comes out as it went in, or is refused with a sentence."""

import numpy as np
import pytest

from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import GripperCommand
from longreach.errors import LiveError, PlanningError
from longreach.geometry import se3
from longreach.io import messages
from longreach.live.protocol import commands, topics
from longreach.live.protocol.topics import TYPES


def test_a_twist_and_a_gripper_command_and_a_pose_come_out_as_they_went_in(rng):
    twist = commands.twist(commands.twist_message(12.5, np.array([0.1, -0.2, 0.3])))
    assert twist.stamp == 12.5
    assert np.array_equal(twist.base, [0.1, -0.2, 0.3])
    for wish in (GripperCommand("position", 0.4), GripperCommand("velocity", -1.0), GripperCommand("force", 20.0)):
        assert commands.gripper(commands.gripper_message(1.0, wish)) == wish
    for T in se3.exp(rng.uniform(-2.0, 2.0, (20, 6))):
        assert np.allclose(commands.tool(messages.tool_pose(TYPES, 1.0, T)), T, atol=1e-9)


def test_the_arms_joints_may_come_in_any_order(thing):
    names = thing.joint_names[thing.arm]
    message = messages.joint_state(TYPES, 1.0, names[::-1], velocity=np.arange(6.0))
    command = commands.arm(message, thing)
    assert command.arm_mode == "velocity"
    assert np.array_equal(command.arm, np.arange(6.0)[::-1])
    assert commands.arm(messages.joint_state(TYPES, 1.0, names, np.ones(6)), thing).arm_mode == "position"


def test_a_trajectory_comes_out_as_it_went_in_through_cdr(thing, rng):
    plan = ConfigurationTrajectory(np.array([2.0, 3.0, 4.5]), rng.normal(size=(3, 9)), thing.joint_names)
    payload = topics.EXECUTE.pack(messages.joint_trajectory(TYPES, 1.0, plan))
    again = commands.trajectory(topics.EXECUTE.unpack(payload), thing)
    assert np.allclose(again.stamps, [0.0, 1.0, 2.5])  # a message counts from its first point
    assert np.array_equal(again.q, plan.q)
    assert np.array_equal(again.velocities, plan.velocities)


def _joints(thing, values, names=None):
    return messages.joint_state(TYPES, 1.0, names or thing.joint_names[thing.arm], velocity=np.array(values))


def _trajectory(thing, stamps, q, names=None):
    plan = ConfigurationTrajectory(np.arange(float(len(q))), np.array(q), names or thing.joint_names)
    message = messages.joint_trajectory(TYPES, 1.0, plan)
    for point, stamp in zip(message.points, stamps, strict=True):
        point.time_from_start.sec = stamp
    return message


@pytest.mark.parametrize(
    ("read", "sentence"),
    [
        (lambda thing: commands.twist(commands.twist_message(1.0, np.array([np.nan, 0.0, 0.0]))), "finite"),
        (lambda thing: commands.twist(commands.twist_message(1.0, np.array([1e300, 0.0, 0.0]))), "finite"),
        (lambda thing: commands.arm(_joints(thing, [0.0] * 5), thing), "each of its joints"),
        (lambda thing: commands.arm(_joints(thing, [np.inf] * 6), thing), "finite"),
        (lambda thing: commands.arm(_joints(thing, [0.0] * 6, ["a"] * 6), thing), "each of its joints"),
        (lambda thing: commands.gripper(_joints(thing, [0.0])), "one number"),
        (lambda thing: commands.tool(messages.tool_pose(TYPES, 1.0, np.full((4, 4), np.nan))), "finite"),
        (lambda t: commands.trajectory(_trajectory(t, [0], [np.zeros(9)], tuple("abcdefghi")), t), "joints"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_with_a_sentence(thing, read, sentence):
    with pytest.raises(LiveError, match=sentence):
        read(thing)


def test_a_trajectory_whose_time_runs_backwards_is_refused(thing):
    with pytest.raises(PlanningError, match="increase"):
        commands.trajectory(_trajectory(thing, [1, 0], np.zeros((2, 9))), thing)
