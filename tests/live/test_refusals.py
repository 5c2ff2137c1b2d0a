"""What a client refuses, what it says of a robot that is stopped, does not arrive or is gone: always a sentence."""

import threading

import numpy as np
import pytest
from live_networks import until

import longreach as lr
from longreach.cli.main import main
from longreach.control.hardware import Command, GripperCommand
from longreach.errors import LiveError, LongreachError
from longreach.geometry import se3
from longreach.live.client import client as client_module
from longreach.live.client.client import connect

pytestmark = pytest.mark.usefixtures("unchecked")  # a user has no check of shapes but the client's own
_UP = np.eye(4)
_NAN = np.full((4, 4), np.nan)


@pytest.fixture
def client(served, to):
    return to(served, name="the first")


@pytest.fixture
def stopped(client):
    client.stop("A test says stop")
    yield client
    client.reset()
    client.release()


def _line(client, **more):
    q = client.state.q
    return lr.ConfigurationTrajectory(np.array([0.0, 1.0]), np.stack([q, q]), client.robot.joint_names, **more)


_WRONG = {
    "NaN for the base": lambda c: c.velocity(base=np.array([np.nan, 0.0, 0.0])),
    "infinity for the arm": lambda c: c.velocity(np.full(6, np.inf)),
    "too few for the base": lambda c: c.velocity(base=[1.0, 2.0]),
    "too many for the arm": lambda c: c.velocity(np.zeros(7)),
    "a word for the arm": lambda c: c.velocity("fast"),
    "an absurd base": lambda c: c.velocity(base=[5.0, 0.0, 0.0]),
    "an absurd arm": lambda c: c.velocity(np.full(6, 50.0)),
    "a command that is none": lambda c: c.write("go"),
    "a position beyond the limits": lambda c: c.write(Command(0.0, np.full(6, 9.0), "position")),
    "a mode that is none": lambda c: c.write(Command(0.0, np.zeros(6), "torque")),
    "a gripper beyond closed": lambda c: c.gripper(1.5),
    "a gripper before open": lambda c: c.gripper(-0.1),
    "a gripper of NaN": lambda c: c.gripper(np.nan),
    "a gripper of a word": lambda c: c.gripper("shut"),
    "a gripper too fast": lambda c: c.gripper(9.0, "velocity"),
    "a gripper too strong": lambda c: c.gripper(1e4, "force"),
    "a mode of the gripper that is none": lambda c: c.gripper(0.5, "squeeze"),
    "a gripper in a command": lambda c: c.write(Command(0.0, gripper=GripperCommand("position", 7.0))),
    "NaN to reach": lambda c: c.reach(_NAN),
    "a mirror to reach": lambda c: c.reach(np.diag([1.0, -1.0, 1.0, 1.0])),
    "a scale to reach": lambda c: c.reach(np.diag([1.1, 1.1, 1.1, 1.0])),
    "a shear to reach": lambda c: c.reach(_UP + 0.2 * np.eye(4, k=1)),
    "a rotation to reach": lambda c: c.reach(np.eye(3)),
    "NaN to move to": lambda c: c.move_to(np.full(6, np.nan)),
    "five joints to move to": lambda c: c.move_to(np.zeros(5)),
    "ten joints to move to": lambda c: c.move_to(np.zeros(10)),
    "one number to move to": lambda c: c.move_to(1.0),
    "nothing to move to": lambda c: c.move_to(None),
    "a ragged list to move to": lambda c: c.move_to([[1.0], [1.0, 2.0]]),
    "beyond the limits to move to": lambda c: c.move_to(np.full(6, 100.0)),
    "a pose of NaN": lambda c: c.move_to(_NAN),
    "a mirrored pose": lambda c: c.move_to(np.diag([1.0, 1.0, -1.0, 1.0])),
    "a pose too far away": lambda c: c.move_to(_UP + 1e9 * np.eye(4, k=3)),
    "a method that is none": lambda c: c.plan(c.robot.forward(c.state.q), method="luck"),
    "a plan of a word": lambda c: c.plan("home"),
    "a plan of a scaled pose": lambda c: c.plan(2.0 * np.eye(4)),
    "a trajectory that is none": lambda c: c.execute(np.zeros((2, 9))),
    "a trajectory of other joints": lambda c: c.execute(
        lr.ConfigurationTrajectory(np.array([0.0]), np.zeros((1, 2)), ("a", "b"))
    ),
    "a trajectory of absurd speeds": lambda c: c.execute(_line(c, velocities=np.full((2, 9), 100.0))),
    "a time limit of a word": lambda c: c.execute(_line(c), timeout="soon"),
    "an unknown frame": lambda c: c.lookup("map", "moon"),
    "a frame that is no name": lambda c: c.lookup("map", ["tool"]),
    "a stamp of NaN": lambda c: c.lookup("map", "tool", np.nan),
    "a stamp of long ago": lambda c: c.lookup("map", "tool", -5.0),
    "a stamp of a word": lambda c: c.lookup("map", "tool", "now"),
}  # fmt: skip


@pytest.mark.parametrize("what", _WRONG)
def test_what_cannot_be_meant_is_refused_in_a_sentence_before_anything_is_sent(client, what):
    holder, refused = client.state.holder, client.state.refused
    with pytest.raises(LongreachError) as error:
        _WRONG[what](client)
    assert str(error.value).endswith(".")
    assert (client.state.holder, client.state.refused) == (holder, refused)
    assert client.state.stop == ""


@pytest.mark.parametrize(
    "arguments",
    [
        {"timeout": 0.0}, {"timeout": -1.0}, {"timeout": np.nan}, {"timeout": np.inf}, {"timeout": "1"},
        {"address": "127.0.0.1:0"}, {"address": "127.0.0.1:99999"}, {"address": "127.0.0.1:²"}, {"address": ""},
        {"address": "127.0.0.1:" + "9" * 5000}, {"address": None}, {"address": "not a host:7447"},
        {"certificates": "nowhere"},
    ],
    ids=lambda arguments: str(arguments)[:40],
)  # fmt: skip
def test_a_connection_that_cannot_be_is_refused_in_a_sentence(arguments):
    with pytest.raises(LongreachError, match=r"\.$"):
        connect(**{"address": "127.0.0.1:9", "timeout": 0.3} | arguments)


_COMMANDS = {
    "velocity": lambda c: c.velocity(base=np.array([0.1, 0.0, 0.0])),
    "write": lambda c: c.write(Command(0.0, np.zeros(6))),
    "gripper": lambda c: c.gripper(0.5),
    "reach": lambda c: c.reach(c.robot.forward(c.state.q)),
    "execute": lambda c: c.execute(_line(c)),
    "move_to": lambda c: c.move_to(c.state.q[3:]),
}


@pytest.mark.parametrize("name", _COMMANDS)
def test_a_command_to_a_robot_that_is_stopped_says_so(stopped, name):
    sentence = r"^The robot is stopped: A test says stop\. Clear it with reset\(\) first\.$"
    with pytest.raises(LiveError, match=sentence):
        _COMMANDS[name](stopped)
    stopped.hold()
    stopped.reset()
    _COMMANDS[name](stopped)  # at once
    stopped.hold()


@pytest.mark.parametrize(
    "options", [["--velocity", "0.1,0,0"], ["--gripper", "0.5"], ["--move-to", "0,-1.8,2,-1.5,-1.57,0"]], ids=str
)
def test_on_the_command_line_too(stopped, capsys, options):
    stopped.release()
    with pytest.raises(SystemExit) as ended:
        main(["connect", stopped._connection._where["address"], *options])
    assert ended.value.code == 2
    assert capsys.readouterr().err.endswith("stopped: A test says stop. Clear it with reset() first.\n")


def test_who_does_not_arrive_hears_how_far_off_the_robot_is(client, monkeypatch):
    monkeypatch.setattr(client_module, "_SETTLING", 0.1)
    monkeypatch.setattr(client_module, "_JOINT", 1e-9)
    with pytest.raises(LiveError, match=r"The plan has ended, but \w+ is \d+ mrad off: it stands still there\."):
        client.move_to(client.state.q[3:] + 0.05)


def test_near_is_5_mm_and_half_a_degree_of_the_tool_and_5_mrad_of_a_joint(thing):
    T, q = thing.forward(thing.home), thing.home
    for away, off in (([0.0049, 0.0, 0.0], ""), ([0.0, 0.0, 0.0051], "the tool is 5.1 mm and 0.00° off")):
        goal = T.copy()
        goal[:3, 3] += away
        assert client_module._tool_away(thing, q, goal) == off
    turned = T @ se3.exp(np.array([0.0, 0.0, 0.0, 0.0, np.radians(0.6), 0.0]))
    assert client_module._tool_away(thing, q, turned) == "the tool is 0.0 mm and 0.60° off"
    for joint, away, off in (
        (0, 0.009, ""),
        (1, 0.011, "the base is 11 mm and 0.00° off"),
        (2, 0.008 - 2.0 * np.pi, ""),
        (2, 0.01, "the base is 0 mm and 0.57° off"),
        (3, 0.0049, ""),
        (4, -0.006, "shoulder_lift_joint is 6 mrad off"),
    ):
        goal = q.copy()
        goal[joint] += away
        assert client_module._joints_away(thing, q, goal) == off


def test_a_move_that_is_ended_early_says_by_what_and_how_far_off_it_is(client):
    far = client.state.q + np.array([0.6, *[0.0] * 8])
    for end, why in ((client.stop, "stopped on the way"), (lambda _: client.hold(), "asked for something else")):
        timer = threading.Timer(0.8, end, ("It was stopped on the way.",))
        timer.start()
        with pytest.raises(LiveError, match=rf"ended early, the base is \d+ mm and .*° off: .*{why}\.$"):
            client.move_to(far)
        timer.join()
        client.reset()


def test_a_callback_may_stop_the_robot_and_end_itself_twice(client):
    asked = []

    def callback(state):
        if not asked:
            asked.append(state)
            client.stop("A callback says stop.")

    end = client.on_state(callback)
    until(lambda: client.state.stop == "A callback says stop.")
    end()
    end()
    client.reset()
    client.release()


_METHODS = {
    **_COMMANDS,
    "hold": lambda c: c.hold(),
    "take": lambda c: c.take(),
    "stop": lambda c: c.stop("\udcff" * 9000),
    "reset": lambda c: c.reset(),
    "plan": lambda c: c.plan(c.robot.forward(c.state.q)),
    "read": lambda c: c.read(),
    "lookup": lambda c: c.lookup("map", "tool"),
    "lr.lookup": lambda c: lr.lookup("map", "tool"),
    "release": lambda c: c.release(),
    "capabilities": lambda c: c.capabilities,
    "the rest": lambda c: (c.state, c.scan, c.plan_running, c.age, c.offset, c.lost, c.delays, c.holds),
    "close": lambda c: c.close(),
    "close again": lambda c: c.close(),
}


def _try_all(client):
    """Call all methods; return which have raised, and how. What is no LongreachError is raised."""
    raised = {}
    for name, do in _METHODS.items():
        try:
            do(client)
        except LongreachError as error:
            raised[name] = str(error)
    return raised


def test_a_client_of_a_server_that_is_killed_says_so(serve, to):
    server = serve().ready()
    client, spare = to(server), to(server)
    timer = threading.Timer(1.0, server.process.kill)
    timer.start()
    with pytest.raises(LiveError, match=r"the base is \d+ mm and .* off: the robot was not heard for \d+\.\d s\."):
        client.move_to(client.state.q + np.array([2.0, *[0.0] * 8]))
    raised = _try_all(client)
    assert {"execute", "move_to", "hold", "take", "stop", "reset"} <= raised.keys()
    assert "has not answered within" in raised["stop"]
    raised = _try_all(client)
    assert {*_COMMANDS, "hold", "take", "stop", "reset"} <= raised.keys()
    assert raised["velocity"] == "The connection with the robot is closed; connect again."
    assert list(client) == []
    spare._connection.session.close()  # as when zenoh gives up by itself
    raised = _try_all(spare)
    assert {*_COMMANDS, "hold", "take", "stop", "reset"} <= raised.keys()
    with pytest.raises(LiveError, match="No robot answers"):
        connect(server.address, timeout=0.3)


def test_a_stop_gets_through_whatever_its_reason_holds(client):
    client.stop("half a character \udcff, " + 9000 * "and more ")
    assert client.state.stop.startswith("half a character ?, and more and more")
    client.reset()
    assert client.state.stop == ""
    client.release()


def test_a_stop_that_the_robot_takes_but_does_not_do_is_an_error(client, monkeypatch):
    """The network's side of a robot answers also when its loop hangs."""
    with monkeypatch.context() as hanging:
        hanging.setattr(client._connection, "order", lambda words: "")
        with pytest.raises(LiveError, match="has not said within 1 s that it is stopped; use its own red button"):
            client.stop()
    client.stop("This one is done.")
    client.stop("And so is another.")
    assert client.state.stop == "And so is another."
    client.reset()
    assert not client.state.latched
