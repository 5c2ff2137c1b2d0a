"""Who is not let in: nothing of theirs is accepted, nothing crashes, each rejection is counted and logged."""

import socket

import numpy as np
import pytest
import zenoh
from live_networks import free_port, until

from longreach.errors import LiveError
from longreach.live.protocol import commands, topics
from longreach.live.protocol.message_header import authentication, pack_header
from longreach.live.protocol.topics import TYPES
from longreach.live.protocol.transport import OPERATOR, WATCHER, open_client, open_server
from longreach.live.server.authentication import Authentication, Rejected, RejectionCounts

_TOKEN, _WATCHERS = "correct horse", "battery staple"


class Sample:
    def __init__(self, payload, header):
        self.payload, self.attachment = payload, header


@pytest.fixture(scope="module")
def guarded(serve):
    return serve(tokens=(_TOKEN, _WATCHERS)).ready()


@pytest.mark.parametrize("address", ["0.0.0.0:7447", "192.168.1.5:7447", "[::]:7447", "robot.example:7447"])
def test_other_machines_are_not_served_without_certificates(address):
    with pytest.raises(LiveError, match="can be reached from other machines: give --certificates"):
        open_server(address, _TOKEN, None)


def test_without_the_token_nobody_comes_in_and_each_try_is_counted_and_logged(guarded, to):
    for token in (None, "wrong"):
        with pytest.raises(LiveError, match="or it wants a"):
            open_client(guarded.address, token, None, 0.3)
    with socket.create_connection(("127.0.0.1", guarded.port)) as garbage:
        garbage.send(np.random.default_rng(0).bytes(3000))
    client = to(guarded, _TOKEN)
    until(lambda: client.state.refused >= 3)
    assert "a connection without the token" in guarded.output
    assert "a connection that speaks something else" in guarded.output
    client.velocity(np.full(6, 0.1))
    assert client.holds


def test_a_message_that_is_not_authentic_is_refused_by_a_robot_with_a_token(guarded, to):
    """Who is let in by zenoh, as a router in between would be, cannot command without the token."""
    client = to(guarded, _TOKEN)
    before = client.state.refused
    session = open_client(guarded.address, _TOKEN, None, 2.0)
    payload = topics.TWIST.pack(commands.twist_message(client.state.stamp, np.array([1.0, 0.0, 0.0])))
    for i in range(10):
        session.put(topics.TWIST.key, payload, attachment=pack_header(i, bytes(16)) + bytes(16 * (i % 2)))
    until(lambda: client.state.refused >= before + 10)
    assert not client.state.velocity[:3].round(2).any()
    assert "not authentic" in guarded.output
    session.close()


def test_a_message_counts_once_and_from_its_server_alone():
    guard = Authentication({OPERATOR: _TOKEN, WATCHER: _WATCHERS}, b"n" * 16, RejectionCounts())
    payload, topic = topics.ORDER.pack(TYPES["std_msgs/msg/String"]("hold")), topics.ORDER

    def signed(number, nonce=b"n" * 16, token=_TOKEN, key=topic.key):
        header = pack_header(number, b"s" * 16)
        return Sample(payload, header + authentication(token, nonce, key, header, payload))

    assert guard.admit(topic, signed(1))[1].data == "hold"
    again = signed(2)
    guard.admit(topic, again)
    for sample, reason in (
        (again, "repeated"),
        (signed(1), "repeated"),
        (signed(3, nonce=b"o" * 16), "not authentic"),
        (signed(3, token="wrong"), "not authentic"),
        (signed(3, token=_WATCHERS), "from a watcher"),
        (signed(3, key=topics.EXECUTE.key), "not authentic"),
        (Sample(payload, pack_header(3, b"s" * 16)), "not authentic"),
        (Sample(payload, None), "without a header"),
        (Sample(None, None), "nothing in it"),
        (Sample(bytes(5000), pack_header(3, b"s" * 16)), "too large"),
    ):
        with pytest.raises(Rejected, match=reason):
            guard.admit(topic, sample)
    guard.admit(topic, signed(3))


def test_a_watcher_who_uses_the_holders_name_and_numbers_takes_no_order_from_it():
    guard = Authentication({OPERATOR: _TOKEN, WATCHER: _WATCHERS}, b"n" * 16, RejectionCounts())
    payload, topic = topics.ORDER.pack(TYPES["std_msgs/msg/String"]("stop")), topics.ORDER
    senders = []
    for number, token in ((1, _TOKEN), (2**62, _WATCHERS), (2, _TOKEN)):
        header = pack_header(number, b"s" * 16)
        mac = authentication(token, b"n" * 16, topic.key, header, payload)
        senders.append(guard.admit(topic, Sample(payload, header + mac))[0].sender)
    assert senders[0] == senders[2] == b"s" * 16 != senders[1]


def test_10_000_fuzzed_payloads_and_some_that_are_too_large_are_refused_and_counted(served, to, rng):
    client = to(served)
    before, q = client.state.refused, client.state.q
    session = open_client(served.address, None, None, 2.0)
    valid = {
        topics.TWIST: commands.twist_message(1.0, np.ones(3)),
        topics.HEARTBEAT: commands.twist_message(1.0, np.ones(3)).header,
    }
    publishers = {
        topic: session.declare_publisher(topic.key, congestion_control=zenoh.CongestionControl.BLOCK)
        for topic in topics.COMMANDS
    }
    for i in range(10_000):
        topic = topics.COMMANDS[i % len(topics.COMMANDS)]
        if topic in valid and i % 2:  # something that was right, with a few bytes changed
            payload = np.frombuffer(topic.pack(valid[topic]), dtype=np.uint8).copy()
            payload[rng.integers(len(payload), size=3)] = rng.integers(256, size=3)
            payload = payload.tobytes()
        else:
            payload = rng.bytes(int(rng.integers(0, 300)))
        header = rng.bytes(33) if i % 3 == 0 else pack_header(i, b"fuzz" * 4)
        publishers[topic].put(payload, attachment=header)
    for topic in topics.COMMANDS:
        publishers[topic].put(bytes(topic.limit + 1), attachment=pack_header(0, b"fuzz" * 4))
    until(lambda: client.state.refused >= before + 10_000 + len(topics.COMMANDS), 20.0)
    assert before + 10_000 + len(topics.COMMANDS) <= client.state.refused < before + 10_100  # others may err, too
    assert np.allclose(client.state.q, q, atol=2e-3)
    assert client.state.stop == ""
    assert client.state.holder == ""
    for reason in ("malformed", "without a header", "too large"):
        assert reason in served.output
    client.velocity(base=np.array([0.1, 0.0, 0.0]))  # it still does what it is asked for by whom it should
    until(lambda: client.state.goal == "velocity")
    session.close()


def test_questions_that_are_none_are_answered_with_a_refusal(served, to, rng):
    client = to(served)
    before = client.state.refused
    session = open_client(served.address, None, None, 2.0)
    for topic in (topics.ORDER, topics.EXECUTE):
        for payload, header in ((rng.bytes(50), pack_header(1, bytes(16))), (b"", None), (None, None)):
            answers = list(session.get(topic.key, payload=payload, attachment=header, timeout=2.0))
            assert topics.ORDER.unpack(bytes(answers[0].ok.payload)).data.startswith("refused: ")
    list(session.get(topics.CLOCK.key, payload=rng.bytes(50), timeout=2.0))
    until(lambda: client.state.refused >= before + 7)
    session.close()


def test_names_and_reasons_from_the_network_are_one_short_line_in_log_and_status(served, to):
    forged = "2026-01-01 00:00:00 The robot has passed its inspection."
    nasty = f"mallory\n{forged}\r\x1b[2J\x00\u202e\u2028{'x' * 100}"
    client = to(served, name=nasty)
    client.take()
    until(lambda: client.state.holder)
    assert client.state.holder == f"mallory {forged}"[:59] + "…"
    client.stop(nasty)
    until(lambda: client.state.stop)
    assert client.state.stop.startswith(f"mallory {forged} [2J xxx")
    for text in (client.state.holder, client.state.stop, client.state.stopped_by):
        assert text.isprintable()
    assert len(client.state.stop) <= 200
    client.reset()
    client.release()
    assert forged not in served.output.splitlines()
    assert "\x1b" not in served.output


def test_a_client_without_a_name_is_somebody_and_a_stop_without_a_reason_has_one(served, to):
    client = to(served, name="\n\t")
    client.take()
    until(lambda: client.state.holder == "somebody")
    client.stop("\x07")
    until(lambda: client.state.stop == "A client says stop.")
    client.reset()
    client.release()


def test_with_certificates_only_who_has_one_of_ours_comes_in(certificates):
    address = f"127.0.0.1:{free_port()}"
    server = open_server(address, None, certificates["robot"])
    for role in ("operator", "watcher"):
        open_client(address, None, certificates[role], 2.0).close()
    for folder in (certificates["strange"], certificates["bare"], None):
        with pytest.raises(LiveError, match="No robot answers"):
            open_client(address, None, folder, 0.2)
    server.close()


def test_with_certificates_of_the_server_and_a_token_the_token_lets_in(certificates):
    address = f"127.0.0.1:{free_port()}"
    server = open_server(address, _TOKEN, certificates["robot"])
    open_client(address, _TOKEN, certificates["bare"], 2.0).close()
    for token in (None, "wrong"):
        with pytest.raises(LiveError, match="No robot answers"):
            open_client(address, token, certificates["bare"], 0.2)
    server.close()


def test_a_flood_of_refusals_is_told_in_one_line_a_second(caplog):
    rejections = RejectionCounts()
    for _ in range(1000):
        rejections.count("malformed", "/cmd_vel")
    rejections.log_all()
    assert rejections.total == 1000
    assert len(caplog.records) == 2
    assert "1000" in caplog.records[-1].getMessage()


def test_reasons_that_are_all_different_do_not_fill_memory_and_log(caplog):
    """Who holds the robot has a name in such a reason, and where a plan begins is a number."""
    rejections = RejectionCounts()
    for i in range(10_000):
        rejections.count(f"The plan begins {i} m away from where the robot is; plan from there.", "/longreach/execute")
    assert rejections.total == 10_000
    assert len(rejections.counts) < 200
    assert len(caplog.records) < 200
