"""A client in one process and a robot in another: what is asked for happens, and who holds the robot decides."""

import time

import numpy as np
import pytest
from live_networks import until

import longreach as lr
from longreach.app import robot_side
from longreach.app.goals import Follow
from longreach.app.operated import simulated
from longreach.app.robot_side import Orders
from longreach.cli.main import main
from longreach.control.hardware import Hardware
from longreach.errors import LiveError, PlanningError
from longreach.live.protocol import topics
from longreach.live.protocol.transport import open_client
from longreach.live.server.serving import tracker_config


@pytest.fixture
def client(served, to):
    return to(served, name="the first")


def _at(client):
    return client.robot.forward(client.state.q)


def test_a_plan_through_the_network_is_driven_as_in_one_process(serve, served, to, thing):
    if not served.fresh:  # the test needs a robot that has stood since it was switched on
        served = serve().ready()
    client, states = to(served), []
    goal = client.state.q + np.array([0.2, 0.05, 0.1, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    client.on_state(states.append)
    client.move_to(goal)
    plan, body, alone = client.plan_running, simulated("kinematic", thing, "laboratory", 0, scans=False), {}
    states = tuple(states)
    began = next(state.stamp for state in states if state.goal == "follow")
    robot_side.run(
        body, lambda stamp: body.advance(max(stamp - body.stamp, 0.0)), thing, np.zeros(3),
        lambda now: Orders(goal=Follow(plan, -0.3) if abs(now - began) < 1e-6 else None),
        lambda record: alone.__setitem__(round(record.tick.stamp, 6), record.tick),
        lambda: "over" if body.stamp > states[-1].stamp else "", tracker_config(body, thing, scans=False),
    )  # fmt: skip
    assert all(np.allclose(s.q, alone[round(s.stamp, 6)].q, atol=1e-6) for s in states)
    assert np.allclose(states[-1].q, goal, atol=5e-3)


def test_a_client_has_the_face_of_hardware_and_hears_125_states_a_second(client):
    assert isinstance(client, Hardware)
    assert client.capabilities.gripper
    assert client.robot.joint_names == lr.load_robot("thing").joint_names
    stamps = []
    client.read()
    ended = client.on_state(lambda state: stamps.append(state.stamp))
    time.sleep(0.5)
    ended()
    assert np.median(np.diff(stamps)) == pytest.approx(0.008, abs=1e-6)
    assert client.age < 0.2
    state = next(iter(client))
    assert state.truth is not None
    assert np.allclose(state.q[:3], state.truth, atol=0.01)
    readings = client.read()
    assert len(readings.joints) > 5
    assert len(readings.wheels) > 2


def test_the_clocks_are_compared(client):
    assert client.state.stamp == pytest.approx(time.time() + client.offset, abs=0.1)


def test_frames_are_looked_up_by_name(client):
    state = client.state
    assert np.allclose(lr.lookup("map", "tool", state.stamp), client.robot.forward(state.q), atol=1e-6)


def test_velocities_move_base_and_arm_and_end_by_themselves(client):
    before = client.state.q
    for _ in range(20):
        client.velocity(np.array([0.2, 0, 0, 0, 0, 0]), np.array([0.3, 0.0, 0.0]))
        time.sleep(0.02)
    assert client.holds
    assert client.state.holder == "the first"
    assert client.state.goal == "velocity"
    until(lambda: client.state.goal == "hold")
    moved = client.state.q - before
    assert moved[0] > 0.05
    assert moved[3] > 0.03


def test_a_pose_of_the_tool_is_planned_and_reached(client):
    T = _at(client)
    T[:3, 3] += [0.02, 0.02, 0.04]
    state = client.move_to(T)
    assert state.progress == 1.0
    assert np.linalg.norm(client.robot.forward(state.q)[:3, 3] - T[:3, 3]) < 0.003
    assert client.plan_running is not None
    assert np.allclose(client.robot.forward(client.plan_running.q[-1])[:3, 3], T[:3, 3], atol=1e-3)


def test_the_command_line_moves_the_tool_by_sqp(client, served, capsys):
    T = _at(client)
    client.release()
    with pytest.raises(SystemExit) as ended:
        main(["connect", served.address, "--tool-by", "0.1,0.1,0.05", "--method", "sqp"])
    assert not ended.value.code, capsys.readouterr().err
    assert np.linalg.norm(_at(client)[:3, 3] - T[:3, 3] - [0.1, 0.1, 0.05]) < 0.005


def test_angles_of_the_arm_are_reached_and_the_fingers_close(client):
    goal = client.state.q[3:] + 0.05
    client.gripper(0.5)
    state = client.move_to(goal)
    assert np.allclose(state.q[3:], goal, atol=2e-3)
    until(lambda: client.read().gripper is None and abs(client.state.joints["finger_a_joint_1"]) > 0.1)


def test_a_dragged_tool_is_pulled_along(client):
    T = _at(client)
    T[2, 3] += 0.02
    client.reach(T)
    until(lambda: np.linalg.norm(_at(client)[:3, 3] - T[:3, 3]) < 2e-3)
    client.hold()
    until(lambda: client.state.goal == "hold")


def test_a_stop_comes_through_in_50_milliseconds_and_holds_until_the_reset(client, served, to):
    client.move_to(client.state.q + np.array([0.5, 0, 0, 0, 0, 0, 0, 0, 0]), wait=False)
    until(lambda: client.state.goal == "follow")
    other = to(served, name="a bystander")
    began = client.state.stamp
    other.stop("That is enough.")
    until(lambda: client.state.stop == "That is enough.")
    assert client.state.latched
    assert client.state.cause == "emergency stop"
    assert client.state.stopped_by == "a client that does not hold the robot"
    assert began <= client.state.stopped_at <= client.state.stamp
    assert client.state.stamp - began < 0.2  # it was seen here, by a slow client; the bar is the benchmark's
    with pytest.raises(LiveError, match=r"stopped: That is enough\. Clear it with reset\(\) first"):
        client.move_to(client.state.q)
    client.reset()
    until(lambda: client.state.stop == "")
    assert (client.state.cause, client.state.stopped_by) == ("", "")
    client.stop()
    until(lambda: client.state.latched)
    assert client.state.stopped_by == "the first"
    client.reset()
    until(lambda: client.state.stop == "")


def test_one_holds_the_robot_and_others_watch(client, served, to):
    client.take()
    other = to(served, name="the second")
    until(lambda: other.state.holder == "the first")
    with pytest.raises(LiveError, match="the first holds the robot; wait until it is released"):
        other.velocity()
    client.release()
    other.velocity()
    until(lambda: client.state.holder == "the second")
    other.close()
    until(lambda: client.state.holder == "")


def test_a_plan_that_cannot_be_followed_is_refused_before_anything_moves(client):
    far = client.state.q + 1.0
    with pytest.raises(LiveError, match="away from where the robot is; plan from there"):
        client.execute(lr.ConfigurationTrajectory(np.array([0.0, 1.0]), np.stack([far, far]), client.robot.joint_names))
    with pytest.raises(PlanningError, match="outside its limits"):
        client.move_to(np.full(6, 100.0))
    T = _at(client)
    T[2, 3] += 5.0
    with pytest.raises(PlanningError, match="choose a pose that the robot can reach"):
        client.move_to(T)


def test_the_command_line_connects_too(served, capsys):
    for options in (["--move-to", "0.1,-2,2,-1.5,-1.57,0"], ["--duration", "0.1"]):
        with pytest.raises(SystemExit) as ended:
            main(["connect", served.address, *options])
        assert not ended.value.code
    said = capsys.readouterr().out
    assert "The robot is at [" in said
    assert "base" in said
    with pytest.raises(SystemExit) as ended:
        main(["connect", served.address, "--velocity", "1,2"])
    assert ended.value.code == 2
    assert "--velocity takes 3 numbers" in capsys.readouterr().err


def test_the_topics_stand_in_the_graph_of_ros_2(served):
    session = open_client(served.address, None, None, 2.0)
    tokens = {str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/0/**", timeout=2.0) if reply.ok}
    assert any(token.endswith("/0/NN/%/%/longreach") for token in tokens)
    _, type, hash = topics.ESTIMATE.key.rsplit("/", 2)
    end = f"/MP/%/%/longreach/%odometry%filtered/{type}/{hash}/::,:,:,:,,"
    assert len([token for token in tokens if token.endswith(end)]) == 1
    session.close()


def test_nobody_there_is_a_sentence():
    with pytest.raises(LiveError, match=r"No robot answers at 127\.0\.0\.1:9"):
        lr.connect("127.0.0.1:9", timeout=0.3)
    with pytest.raises(LiveError, match="write it as host:port"):
        lr.connect("nowhere")
