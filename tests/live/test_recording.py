"""What is recorded, at the server and at a client: all that the robot says, safe whoever is killed."""

import logging
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from live_networks import Served, until

import longreach as lr
from longreach.io.bag_file import open_bag
from longreach.io.bag_info import inspect

_RECORDS = """
import sys, threading, longreach as lr
with lr.connect(sys.argv[1], name="recorder") as client:
    recorder = client.record(sys.argv[2])
    print("recording", flush=True)
    for state in client:
        print(f"{state.stamp:.3f}", flush=True)
"""


def said(path):
    """topic → type, and stamps of recording and payloads of its messages."""
    found = {}
    with open_bag(path) as bag:
        for name, type, stamp, raw in bag.raw_messages([(topic.name, topic.type) for topic in bag.topics]):
            found.setdefault((name, type), []).append((1e-9 * stamp, raw))
    return found


@pytest.mark.parametrize("after", [0.7, 1.9, 3.2])
def test_what_a_killed_server_recorded_can_be_read_up_to_its_last_second(serve, to, tmp_path, after):
    record = tmp_path / "run.mcap"
    served = serve("--record", record).ready()
    client = to(served)
    time.sleep(after)
    served.process.kill()
    served.process.wait()
    last = client.state.stamp
    info = inspect(record)
    assert last - 1.0 < info.start + info.duration
    (remark,) = info.remarks
    assert f"its file has no end: the {info.duration:.1f} s" in remark
    assert len({topic.topic for topic in info.topics}) >= 9
    command = [sys.executable, "-m", "longreach", "estimate", record, "--robot", "thing", "--out", tmp_path / "out"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert f"note: {remark}" in done.stdout
    assert [path.name for path in tmp_path.glob(".*")] == []


@pytest.mark.parametrize("after", [0.6, 1.7, 3.1])
def test_what_a_killed_client_recorded_can_be_read_up_to_its_last_second(served, tmp_path, after):
    record = tmp_path / "run.mcap"
    with subprocess.Popen([sys.executable, "-c", _RECORDS, served.address, record], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"recording\n"
        time.sleep(after)
        process.kill()
        last = float(process.stdout.read().split(b"\n")[-2])
    info = inspect(record)
    assert last - 1.0 < info.start + info.duration
    assert "its file has no end" in info.remarks[0]


def test_a_client_that_is_interrupted_leaves_a_whole_recording(served, tmp_path):
    record = tmp_path / "run.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", _RECORDS, served.address, record], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout.readline() == b"recording\n"
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        process.communicate()
    info = inspect(record)
    assert info.remarks == ()
    assert info.duration > 0.5


def test_a_client_records_all_topics_as_the_server_does_and_they_make_the_same_estimate(serve, to, tmp_path, unchecked):
    there, here = tmp_path / "there.mcap", tmp_path / "here.mcap"
    served = serve("--record", there, "--scans").ready()
    client = to(served)
    with client.record(here) as recorder:
        began = client.state.stamp
        while client.state.stamp < began + 2.5:
            client.velocity(base=np.array([0.3, 0.1, 0.2]))
            time.sleep(0.05)
    assert recorder.error == ""
    assert client.lost == 0
    served.end()
    at_server, at_client = said(there), said(here)
    assert set(at_client) == set(at_server)
    whole = {name: {raw for _, raw in rows} for name, rows in at_server.items()}
    for name, rows in at_client.items():
        if name[0] != "/tf_static":  # its stamp is of when it was asked for
            assert {raw for _, raw in rows} <= whole[name], name
    start, end = (at_client["/odometry/filtered", "nav_msgs/msg/Odometry"][i][0] for i in (0, -1))
    for name in whole:
        if name[0] not in ("/tf_static", "/diagnostics"):
            common = [raw for stamp, raw in at_server[name] if start + 0.1 < stamp < end - 0.1]
            mine = {raw for _, raw in at_client[name]}
            assert len(common) > 3, name
            assert all(raw in mine for raw in common), name
    thing = lr.load_robot("thing")
    recordings = [lr.read_recording(path, thing) for path in (there, here)]
    first = max(recording.wheels[0].stamp for recording in recordings) + 0.2  # a scan comes later than it was taken
    last = min(recording.wheels[-1].stamp for recording in recordings) - 0.2

    def rows(recording):
        kept = {
            kind: tuple(one for one in getattr(recording, kind) if first <= one.stamp <= last)
            for kind in ("wheels", "scans", "imu", "joints")
        }
        return lr.estimate(recording.replace(**kept, truth=None), thing).trajectories["fused"]

    a, b = map(rows, recordings)
    assert len(a) > 150
    np.testing.assert_array_equal(a.stamps, b.stamps)
    np.testing.assert_array_equal(a.poses, b.poses)
    np.testing.assert_array_equal(a.covariance, b.covariance)


def test_a_client_may_record_again_and_hears_nothing_twice(served, to, tmp_path):
    client = to(served)
    client.read()  # wheels and IMU are heard already
    for name in ("one.mcap", "two.mcap"):
        with client.record(tmp_path / name):
            time.sleep(1.0)
    for name in ("one.mcap", "two.mcap"):
        rates = {topic.topic: topic.rate for topic in inspect(tmp_path / name).topics}
        assert rates["/imu/data"] == pytest.approx(100.0, rel=0.2)
        assert rates["/joint_states"] == pytest.approx(50.0, rel=0.2)
    client.read()
    time.sleep(0.5)
    stamps = [reading.stamp for reading in client.read().imu]
    assert len(stamps) == len(set(stamps)) > 20


def test_what_cannot_be_read_is_not_recorded(served, to, tmp_path, caplog):
    """Whoever is let in can speak on any topic."""
    from longreach.live.protocol import topics
    from longreach.live.protocol.message_header import pack_header

    client, stranger = to(served), to(served)
    caplog.set_level(logging.ERROR)
    with client.record(tmp_path / "run.mcap"):
        time.sleep(0.3)
        for topic in (topics.ESTIMATE, topics.SETTLED, topics.TF, client._subscriber.sensed.imu):
            for payload in (b"", b"\0\1\0\0" + os.urandom(20), os.urandom(100)):
                stranger._connection.session.put(topic.key, payload, attachment=pack_header(1, bytes(16)))
        before = client.state.stamp
        until(lambda: client.state.stamp > before + 0.5)
    thing = lr.load_robot("thing")
    recording = lr.read_recording(tmp_path / "run.mcap", thing)
    assert len(recording.imu) > 30
    with open_bag(tmp_path / "run.mcap") as bag:
        assert sum(1 for _ in bag.messages([(topic.name, topic.type) for topic in bag.topics])) > 300


def test_a_server_whose_disk_is_full_says_so_and_goes_on_and_ends_with_it(serve, to, tmp_path):
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000)); "
    folder, record = tmp_path / "served", tmp_path / "run.mcap"
    folder.mkdir()
    served = Served(folder, "--record", record, before=limit).ready()
    try:
        client = to(served)
        until(lambda: "cannot be written any more" in served.output, 30.0)
        full = client.state.stamp
        until(lambda: client.state.stamp > full + 2.0, 20.0)
    finally:
        served.end()
    sentence = f"{record} cannot be written any more: File too large. What was recorded before can be read."
    assert served.process.returncode == 2
    *before, last = served.output.splitlines()
    assert sum(sentence in line for line in before) == 1  # in the log, when it happened
    assert last == f"longreach: {sentence}"
    assert "The recording is" not in served.output
    info = inspect(record)
    assert info.duration > 0.2
    assert "its file has no end" in info.remarks[0]
