"""What `longreach view` records in its page is not lost, however the view ends."""

import signal
import subprocess
import sys

import pytest
from live_networks import free_port
from page_parts import press, until

from longreach.io.bag_info import inspect


@pytest.mark.parametrize("ended_by", [signal.SIGINT, signal.SIGKILL], ids=["Ctrl-C", "SIGKILL"])
def test_a_recording_of_the_page_is_there_when_the_view_is_ended(served, page, tmp_path, ended_by):
    port = free_port()
    view = [sys.executable, "-m", "longreach", "view", "--connect", served.address, "--port", str(port)]
    with subprocess.Popen(view, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        try:
            while "Open http" not in (line := process.stdout.readline()):
                assert line, "the view has ended"
            page.goto(next(word for word in line.split() if word.startswith("http")))
            press(page, "Record")
            until(lambda: list(tmp_path.glob("out/session-*.mcap")), page)
            page.wait_for_timeout(2000)
            process.send_signal(ended_by)
            process.wait(30.0)
        finally:
            process.kill()
    (record,) = tmp_path.glob("out/*.mcap")
    info = inspect(record)
    assert info.duration > 0.5
    assert {"/imu/data", "/joint_states", "/arm/joint_states", "/odom", "/tf"} <= {topic.topic for topic in info.topics}
    if ended_by == signal.SIGINT:
        assert info.remarks == ()
        return
    assert "its file has no end" in info.remarks[0]
    estimated = [sys.executable, "-m", "longreach", "estimate", record, "--robot", "thing", "--out", tmp_path / "e"]
    assert subprocess.run(estimated, capture_output=True).returncode == 0
