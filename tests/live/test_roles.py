"""Operators and watchers, by token and by certificate: a watcher sees all and may stop the robot, and no more."""

import numpy as np
import pytest
from live_networks import until

from longreach.errors import LiveError
from longreach.live.protocol import commands, topics, transport
from longreach.live.protocol.message_header import pack_header, signed
from longreach.live.protocol.topics import TYPES

_TOKENS = {"operator": "correct horse", "watcher": "battery staple"}
_TWIST = np.array([0.3, 0.0, 0.0])


@pytest.fixture(scope="module", params=["tokens", "certificates"])
def roles(request, serve):
    """A server, and what connects to it as an operator or as a watcher."""
    if request.param == "tokens":
        return serve(tokens=_TOKENS.values()).ready(), lambda role: {"token": _TOKENS[role]}
    folders = request.getfixturevalue("certificates")
    return serve("--certificates", folders["robot"]).ready(), lambda role: {"certificates": folders[role]}


@pytest.fixture
def both(roles, to):
    served, how = roles
    operator, watcher = (to(served, name=role, **how(role)) for role in ("operator", "watcher"))
    operator.reset()
    operator.release()
    return served, operator, watcher


def test_a_watcher_sees_everything(both):
    _, operator, watcher = both
    assert (operator.role, watcher.role) == ("operator", "watcher")
    operator.velocity(base=_TWIST)
    until(lambda: watcher.state.holder == "operator")
    assert watcher.robot.joint_names == operator.robot.joint_names
    assert abs(watcher.offset - operator.offset) < 1.0
    target = operator.state.q + np.array([0.0] * 3 + [0.1] + [0.0] * 5)
    operator.move_to(target)
    until(lambda: watcher.plan_running is not None and np.allclose(watcher.plan_running.q[-1], target))
    assert np.allclose(watcher.state.q, target, atol=0.01)


def test_a_watcher_cannot_take_command_or_reset_and_each_try_is_counted_and_answered(both):
    served, operator, watcher = both
    before, q = watcher.state.refused, operator.state.q
    for attempt in (
        watcher.take, watcher.reset, watcher.hold, lambda: watcher.velocity(base=_TWIST), lambda: watcher.move_to(q),
    ):  # fmt: skip
        with pytest.raises(LiveError, match="from a watcher, who may look and stop only"):
            attempt()
    until(lambda: watcher.state.refused >= before + 5)
    assert not watcher.holds
    assert watcher.state.holder == ""
    assert "from a watcher" in served.output
    assert np.allclose(operator.state.q, q, atol=2e-3)


def test_a_watchers_commands_move_nothing_while_an_operator_holds_the_robot(both):
    """Who does not use our client signs as well as a watcher can, in the operator's name."""
    _, operator, watcher = both
    operator.take()
    before, connection = watcher.state.refused, watcher._connection
    for topic, message in (
        (topics.TWIST, commands.twist_message(connection.now, np.array([1.0, 0.0, 0.0]))),
        (topics.GRIPPER, commands.gripper_message(connection.now, commands.GripperCommand("position", 1.0))),
        (topics.HEARTBEAT, commands.messages.header(TYPES, connection.now, "")),
    ):
        payload = topic.pack(message)
        header = pack_header(2**62, operator._connection.sender)
        mac = signed(connection._key, connection._nonce, topic.key, header, payload)
        for attachment in (mac, header, header + bytes(16)):
            connection.session.put(topic.key, payload, attachment=attachment)
    until(lambda: watcher.state.refused >= before + 9)
    assert np.abs(operator.state.velocity[:3]).max() < 0.02
    operator.hold()  # the operator's own numbers still count


def test_a_watcher_stops_the_robot_whoever_holds_it_and_an_operator_resets_it(both):
    _, operator, watcher = both
    operator.take()
    watcher.stop("The watcher has seen something.")
    until(lambda: operator.state.latched)
    assert "The watcher has seen something" in operator.state.stop
    with pytest.raises(LiveError, match="from a watcher"):
        watcher.reset()
    operator.reset()
    until(lambda: not operator.state.latched)


def test_nobody_who_is_let_in_can_publish_or_answer_in_the_servers_place(roles, both, to):
    """Access control drops what only the server says: other clients do not get to see it."""
    served, how = roles
    _, operator, watcher = both
    forger = to(served, **how("operator"))._connection.session
    heard, asked = [], []
    subscription = watcher._connection.session.declare_subscriber("**", lambda x: heard.append(bytes(x.payload)))
    spy = forger.declare_queryable("0/longreach/order/**", asked.append)
    for key in ("0/a/forgery", topics.ESTIMATE.key):
        forger.put(key, b"forged", attachment=pack_header(1, bytes(16)))
    watcher.stop("Is anybody listening?")
    operator.reset()
    count = len(heard)
    until(lambda: len(heard) > count + 20)
    assert b"forged" not in heard
    assert asked == []
    spy.undeclare()
    subscription.undeclare()


def test_an_operators_key_is_given_to_nobody_but_operators(both):
    _, operator, watcher = both
    keys = {client.name: client._connection._key for client in (operator, watcher)}
    assert keys["operator"] != keys["watcher"]
    for client in (operator, watcher):
        found = [bytes(reply.ok.payload) for key in ("**", "longreach/**", f"{transport.ROLE_KEYS}/operator")
                 for reply in client._connection.session.get(key, timeout=2.0) if reply.ok is not None]  # fmt: skip
        certified = client._connection._where["token"] is None
        assert (keys["operator"].encode() in found) == (client is operator and certified)
