"""`longreach serve --hardware ros` beside a simulated robot on ROS topics, and a client that drives the one by the
other: a robot at the other end of two networks."""

import sys
import time

import numpy as np
import pytest
from ros_clients import joint_positions
from ros_nodes import free_port, process, until

import longreach as lr
from longreach.errors import LiveError

pytest.importorskip("zenoh", reason="a robot over a network needs the extra live")


@pytest.fixture(scope="module")
def client(ros, nodes):
    address = f"127.0.0.1:{free_port()}"
    serve = [sys.executable, "-m", "longreach", "serve", "--hardware", "ros", "--address", address]
    with nodes("robot", "--no-physics"), process(serve, ros) as serving:
        found = []

        def answers():
            assert serving.poll() is None
            try:
                found.append(lr.connect(address, timeout=1.0))
            except LiveError:
                time.sleep(0.2)
            return found

        until(answers, 90.0, "the server")
        with found[0]:
            yield found[0]


def test_a_client_moves_arm_and_base_of_a_ros_robot_to_where_it_says(client, other):
    goal = client.state.q + np.array([0.15, 0.05, 0.1, 0.2, 0.1, 0.0, 0.0, 0.0, -0.2])
    state = client.move_to(goal)
    assert np.allclose(state.q, goal, atol=0.01)
    names = client.robot.joint_names[client.robot.arm]
    assert np.allclose(other(joint_positions, names), goal[client.robot.arm], atol=0.01)


def test_a_client_brings_the_tool_of_a_ros_robot_to_a_pose(client):
    T = client.robot.forward(client.state.q)
    T[:3, 3] += [0.02, 0.03, 0.05]
    state = client.move_to(T)
    assert np.linalg.norm(client.robot.forward(state.q)[:3, 3] - T[:3, 3]) < 0.01


def test_a_stop_holds_a_ros_robot_until_the_reset(client):
    client.move_to(client.state.q + np.array([0.0, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0, 0.0, 0.0]), wait=False)
    until(lambda: abs(client.state.velocity[3]) > 0.1)
    client.stop("for the test")
    until(lambda: abs(client.state.velocity[3]) < 0.01)
    assert client.state.latched
    client.reset()
    until(lambda: client.state.stop != "for the test")


def test_the_fingers_of_a_ros_robot_close_by_its_gripper_action(client):
    assert client.capabilities.gripper
    before = client.state.joints["finger_a_joint_1"]
    client.gripper(0.5)
    until(lambda: client.state.joints["finger_a_joint_1"] - before > 0.2)
    client.gripper(0.0)
    until(lambda: client.state.joints["finger_a_joint_1"] < before + 0.05)
