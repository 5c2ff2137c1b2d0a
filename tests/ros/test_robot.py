"""The simulated Thing behind ROS topics, driven by ROS' own clients and by ours, its frames held against ROS' tf."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from ros_clients import action_goals, driven, followed, frames_by_tf, joint_positions, stopped

from longreach.geometry import se3, so3
from longreach.io.robots import load_robot
from longreach.robot.chain import KinematicChain
from longreach.robot.urdf import read_urdf

PUBLISHER = Path("/usr/lib/robot_state_publisher/robot_state_publisher")
PREEMPTED, SUCCEEDED, ABORTED, REJECTED = 2, 3, 4, 5


@pytest.fixture(scope="module")
def thing():
    return load_robot("thing")


@pytest.fixture(scope="module")
def robot(launched):
    """A simulated Thing that runs, and robot_state_publisher with its URDF."""
    with launched("simulated.launch") as running:
        yield running


def test_an_action_moves_the_arm_to_its_goal_and_tells_how_it_ended(thing, robot, other, needs):
    needs("actionlib")
    names, q = thing.joint_names[thing.arm], thing.home[thing.arm]
    goals = [
        (q + 0.15, 1.0, (0.0, 0.0), None),
        (q, 0.1, (0.01, 0.0), None),  # faster than the arm can
        (q, 0.1, (-1.0, 0.1), None),
        (q + 10.0, 1.0, (0.0, 0.0), None),  # beyond its limits
        (q, 2.0, (0.0, 0.0), 0.3),
    ]
    reached, hurried, slow, far, cancelled = other(action_goals, names, goals)
    assert reached[:2] == (SUCCEEDED, 0)
    assert reached[3] > 5
    assert hurried[:2] == (ABORTED, -4)
    assert "off" in hurried[2]
    assert slow[:2] == (ABORTED, -4)
    assert "rad/s off" in slow[2]
    assert far[:2] == (REJECTED, -1)
    assert "beyond its limits" in far[2]
    assert cancelled[0] == PREEMPTED


def test_the_arm_is_where_the_action_said_that_it_arrived(thing, robot, other, needs):
    needs("actionlib")
    names, q = thing.joint_names[thing.arm], thing.home[thing.arm] + 0.1
    (ended,) = other(action_goals, names, [(q, 1.5, (0.0, 0.0), None)])
    assert ended[:2] == (SUCCEEDED, 0)
    assert np.abs(other(joint_positions, names) - q).max() < 0.01


@pytest.mark.parametrize("arm", ["velocity", "trajectory"])
def test_our_hardware_drives_base_and_arm_and_lets_go(thing, robot, other, arm):
    velocity = [0.2, 0.0, 0.0, 0.0, 0.0, -0.2]
    took, moved, before, after, still, counts = other(driven, thing, arm, [0.2, 0.0, 0.0], velocity, 1.0)
    # On a slow machine commands take longer to send, and the robot's time is slow: it goes less far, and never further
    # than in the time that they were sent in, until it is at rest.
    least, most = 0.3 * took, took + 0.5
    sure = np.array(velocity) != 0.0
    part = moved[sure] / np.array(velocity)[sure]
    forward = np.linalg.norm((after - before)[:2]) / 0.2
    assert np.all((part > least) & (part < most)), (part, forward, took, counts)
    np.testing.assert_allclose(moved[~sure], 0.0, atol=0.01)
    assert least < forward < most
    assert still
    assert all(count > 10 for count in counts.values()), counts


def test_the_stop_brakes_everything_and_lets_go_when_it_is_let_go(thing, robot, other):
    moving, pressed, after, told = other(stopped, thing, [0.2, 0.0, 0.0])
    assert moving > 0.03  # 0.2 on a machine that keeps up
    assert abs(pressed) < 0.01
    assert after > 0.03
    assert told


def test_robot_state_publisher_places_our_frames_where_our_kinematics_does(thing, robot, other, needs):
    if not PUBLISHER.is_file():
        pytest.skip("Debian's ros-robot-state-publisher is not installed")
    needs("tf2_py")
    needs("tf2_msgs.msg")
    path = files("longreach") / "robot/descriptions/thing.urdf"
    urdf = read_urdf(path)
    ends = [joint.child for joint in urdf.joints if "wheel" not in joint.name]
    chains = {end: KinematicChain.from_urdf(path, "base_link", end) for end in ends}
    joints = tuple(joint.name for joint in urdf.joints if joint.moves and "wheel" not in joint.name)
    found = other(frames_by_tf, "base_link", ends, joints, 5)
    off = []  # of each time that tf was asked, the link that is furthest off
    for q, placed in found:
        angles = dict(zip(joints, q.tolist(), strict=True))
        told = {}
        for end, chain in chains.items():
            T = chain.forward(np.array([angles[name] for name in chain.joint_names]))
            x, y, z, *turn = placed[end].tolist()
            told[end] = np.abs(se3.from_rotation_translation(rotation(*turn), np.array([x, y, z])) - T).max()
        q_all = np.concatenate([np.zeros(3), [angles[name] for name in thing.joint_names[thing.arm]]])
        told["tool of the plans"] = np.abs(thing.forward(q_all)[:3, 3] - placed["tool"][:3]).max()
        off.append(max(told.values()))
    assert np.median(off) < 1e-9, off
    assert max(off) < 2e-4, off  # joint states and tf of two moments, while the arm settles


def test_the_estimate_beside_the_robot_follows_it(thing, robot, nodes, other):
    with nodes("estimate", "--robot", "thing"):
        estimated, true, frame, sources = other(followed, thing, [0.3, 0.1, 0.2], 2.0)
    assert np.linalg.norm(true[:2]) > 0.3
    np.testing.assert_allclose(estimated, true, atol=0.02)
    assert frame == ("odom", "base_link")
    assert {"longreach: wheels", "longreach: imu", "longreach: lidar", "longreach: robot"} <= sources


def rotation(x, y, z, w):
    axis = np.array([x, y, z])
    size = np.linalg.norm(axis)
    return so3.exp(2.0 * np.arctan2(size, w) / size * axis) if size > 0 else np.eye(3)
