"""What the robot does when its client dies, the network is cut, slow or lossy; the recording is whole all the same."""

import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from live_networks import Lossy, Network, until

from longreach.live.client.motions import straight
from longreach.live.protocol import transport

# Drives the base and says so; lives until it is killed.
_DRIVER = """
import sys, time, numpy as np, longreach as lr
client = lr.connect(sys.argv[1], name="the driver")
print("driving", flush=True)
while True:
    client.velocity(np.array([0.2, 0, 0, 0, 0, 0]), np.array([0.4, 0.0, 0.0]))
    time.sleep(0.02)
"""

# Holds the robot and lets none of its own threads run for a while; then it waits.
_BUSY = """
import sys, time, longreach as lr
client = lr.connect(sys.argv[1], name="the busy one")
client.take()
while not (client._connection._heartbeat and client._connection._heartbeat.beat()):
    time.sleep(0.02)
print("busy", flush=True)
began = time.monotonic()
while time.monotonic() - began < 0.5:
    sum(range(12_000_000))
print(time.monotonic() - began, flush=True)
time.sleep(60.0)
"""


@pytest.fixture(scope="module", autouse=True)
def lossy_server(serve):
    return serve(protocol="udp")  # starts while the tests before it run


class Watched:
    """All that a client has heard since it began to watch."""

    def __init__(self, client):
        self.states = []
        self.end = client.on_state(self.states.append)

    def column(self, name):
        return np.array([getattr(state, name) for state in self.states])


def _braked_within_limits(thing, watched, since):
    """Whether the base came to rest as hard as it may at most, and stood still; returns when [s]."""
    until(lambda: abs(watched.states[-1].velocity[0]) < 0.01, 2.0)
    t, speed = watched.column("stamp"), np.abs(watched.column("velocity")[:, 0])
    standing = t[(t > since) & (speed < 0.02)][0]
    hardest = thing.limits.acceleration[0]
    assert standing - since < 0.25 + 0.4 / hardest + 0.15  # until it is seen, braking, the estimate's lag
    return standing


def test_a_client_that_is_killed_leaves_a_robot_that_stands(served, to, thing):
    watcher = to(served)
    with subprocess.Popen([sys.executable, "-c", _DRIVER, served.address], stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout.readline() == "driving\n"
        until(lambda: watcher.state.velocity[0] > 0.35)
        watched = Watched(watcher)
        driver.kill()
        killed = watcher.state.stamp
    until(lambda: "was not heard" in watcher.state.stop, 1.0)
    stopped = watched.states[-1].stamp
    assert stopped - killed < 0.25 + 0.1  # the status comes every 0.1 s at the latest, at once where it changes
    until(lambda: abs(watcher.state.velocity[0]) < 0.01, 2.0)
    _braked_within_limits(thing, watched, killed)
    until(lambda: watcher.state.holder == "", 4.0)  # and another may take it
    watcher.take()
    watcher.velocity(base=np.array([0.1, 0.0, 0.0]))
    until(lambda: watcher.state.goal == "velocity" and watcher.state.stop == "")
    watcher.release()


def test_a_client_that_is_busy_is_not_taken_for_gone_and_one_that_is_halted_is(served, to):
    watcher = to(served)
    with subprocess.Popen([sys.executable, "-c", _BUSY, served.address], stdout=subprocess.PIPE, text=True) as busy:
        assert busy.stdout.readline() == "busy\n"
        watched, began = Watched(watcher), time.monotonic()
        assert float(busy.stdout.readline()) > 0.5
        assert time.monotonic() - began > 0.5
        assert not [state for state in watched.states if state.stop]
        busy.send_signal(signal.SIGSTOP)
        until(lambda: "was not heard" in watcher.state.stop, 0.25 + 0.1 + 0.1)
        busy.send_signal(signal.SIGCONT)
        until(lambda: watcher.state.stop == "")
        busy.kill()
    until(lambda: watcher.state.holder == "", 4.0)


def test_a_network_that_is_cut_ends_the_plan_and_the_client_commands_anew_when_it_is_back(served, to, thing):
    watcher, network = to(served), Network(served.port)
    client = to(network.address, name="through the network")
    goal = watcher.state.q.copy()
    goal[0] += 0.6
    client.move_to(goal, wait=False)
    until(lambda: watcher.state.velocity[0] > 0.2)
    watched = Watched(watcher)
    network.cut = True
    cut = watcher.state.stamp
    until(lambda: "was not heard" in watcher.state.stop, 1.0)
    assert watcher.state.stamp - cut < 0.25 + 0.1
    assert watcher.state.goal == "hold"
    until(lambda: abs(watcher.state.velocity[0]) < 0.01, 2.0)
    _braked_within_limits(thing, watched, cut)
    where = watcher.state.q[0]
    network.cut = False
    until(lambda: watcher.state.stop == "", 5.0)
    time.sleep(0.5)
    assert watcher.state.q[0] == pytest.approx(where, abs=0.005)  # the plan does not go on by itself
    assert where < goal[0] - 0.05
    client.move_to(goal)
    assert watcher.state.q[0] == pytest.approx(goal[0], abs=0.01)
    client.release()


def test_a_client_that_is_asked_to_resume_commands_what_is_left_after_a_cut_and_says_so(served, to, thing, caplog):
    watcher, network = to(served), Network(served.port)
    client = to(network.address, name="through the network")
    goal = watcher.state.q.copy()
    goal[1] += 0.6
    cutter = threading.Timer(0.8, lambda: setattr(network, "cut", True))
    mender = threading.Timer(4.0, lambda: setattr(network, "cut", False))
    cutter.start()
    mender.start()
    watched = Watched(watcher)
    state = client.execute(straight(thing, watcher.state.q, goal), resume=True)
    assert state.q == pytest.approx(goal, abs=0.01)
    assert any("was not heard" in why for why in {state.why for state in watched.states})
    assert "what is left is commanded now" in caplog.text
    client.release()


def test_200_milliseconds_of_delay_are_borne_and_the_offset_of_the_clocks_is_still_known(served, to):
    watcher, network = to(served), Network(served.port)
    client = to(network.address, name="far away")
    network.delay = 0.2
    offsets = []
    for line in (watcher._connection, client._connection, watcher._connection):
        line._pings.clear()
        line.ping()
        offsets.append(line.offset)
    before, through, after = offsets  # a simulation that cannot keep up falls behind the wall's clock meanwhile
    assert min(before, after) - 0.05 < through < max(before, after) + 0.05
    goal = watcher.state.q.copy()
    goal[3] += 0.2
    watched = Watched(watcher)
    state = client.move_to(goal)
    assert state.progress == 1.0
    assert not [s for s in watched.states if s.stop]  # it never took the client for gone
    assert watcher.state.q[3] == pytest.approx(goal[3], abs=3e-3)
    client.release()


def test_5_percent_of_lost_messages_do_not_stop_the_robot(lossy_server, to, monkeypatch):
    monkeypatch.setattr(transport, "PROTOCOL", "udp")
    network = Lossy(lossy_server.ready().port, 0.05)
    watcher_of_all, client = to(lossy_server), to(network.address, name="lossy")
    client.take()
    network.lost = network.part
    watched = Watched(watcher_of_all)
    for _ in range(50):
        client.velocity(base=np.array([0.2, 0.0, 0.0]))
        time.sleep(0.02)
    assert network.dropped > 5
    assert client.lost > 0
    assert watched.states[-1].velocity[0] == pytest.approx(0.2, abs=0.05)
    assert not [s for s in watched.states if s.stop]


def test_the_states_of_a_client_end_when_it_is_closed_or_the_robot_is_gone_and_go_on_after_a_short_silence(serve, to):
    served = serve().ready()
    heard, threads = {"closed": 0.0, "stays": 0.0}, {}

    def watch(name, client):
        for state in client:
            heard[name] = state.stamp

    clients = {name: to(served, name=name) for name in heard}
    for name, client in clients.items():
        threads[name] = threading.Thread(target=watch, args=(name, client), daemon=True)
        threads[name].start()
    until(lambda: all(heard.values()))
    clients["closed"].close()
    threads["closed"].join(2.0)
    assert not threads["closed"].is_alive()
    assert list(clients["closed"]) == []
    served.process.send_signal(signal.SIGSTOP)
    time.sleep(1.5)
    before = heard["stays"]
    served.process.send_signal(signal.SIGCONT)
    until(lambda: heard["stays"] > before)
    served.process.kill()
    threads["stays"].join(10.0)
    assert not threads["stays"].is_alive()


def test_told_to_end_the_server_leaves_a_whole_recording_whatever_has_come_before(served, to):
    to(served).close()
    said = served.end()
    assert served.process.returncode == 0, said
    info = subprocess.run([sys.executable, "-m", "longreach", "info", served.record], capture_output=True, text=True)
    found = {words[0]: words[1:] for line in info.stdout.splitlines() if len(words := line.split()) == 6}
    for name, rate in (("/joint_states", 50.0), ("/arm/joint_states", 125.0), ("/truth", 125.0), ("/imu/data", 100.0)):
        _, _, at, longest_gap, backward = found[name]
        assert float(at) == pytest.approx(rate, rel=0.05)
        assert float(longest_gap) < 1.5 / rate, name  # not one is missing
        assert backward == "0"
