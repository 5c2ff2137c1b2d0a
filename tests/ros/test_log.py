"""What a launch script can wait for: each program of ROS says what it waits for, and when it is ready."""

import re
import sys

from ros_nodes import free_port, process, until

_LONGREACH = (sys.executable, "-m", "longreach")


def test_a_server_of_a_ros_robot_says_what_it_waits_for_and_when_it_is_ready(ros, tmp_path):
    logs = {name: tmp_path / f"{name}.log" for name in ("robot", "serve")}
    address = f"127.0.0.1:{free_port()}"
    serve = (*_LONGREACH, "serve", "--hardware", "ros", "--no-scans", "--address", address, "--token-file", "token")
    (tmp_path / "token").write_text("correct horse")
    (tmp_path / "token").chmod(0o600)
    serve = [str(tmp_path / "token") if word == "token" else word for word in serve]

    def said(name, sentence, seconds=90.0):
        until(lambda: sentence in logs[name].read_text(), seconds, f"{sentence!r} of {name}")

    with logs["serve"].open("w") as log, process(serve, ros, log):
        said("serve", "Waiting for the ROS master at http://127.0.0.1")
        said("serve", "The ROS master has answered; this is the node /longreach_hardware")
        said("serve", "Waiting for a robot that says where its joints are on /")
        assert "A robot says where its joints are" not in logs["serve"].read_text()
        with logs["robot"].open("w") as other, process((*_LONGREACH, "ros", "robot", "--no-physics"), ros, other):
            said("robot", "The simulated thing is ready.")
            said("serve", "A robot says where its joints are on")
            said("serve", "A robot listens on /arm_velocity_controller/command and /cmd_vel.")


def test_the_estimate_says_when_it_is_ready_on_standard_error_after_the_time(ros, tmp_path):
    with (tmp_path / "log").open("w") as log, process((*_LONGREACH, "ros", "estimate"), ros, log):
        ready = re.compile(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} The estimate of thing is ready\.$", re.MULTILINE)
        until(lambda: ready.search((tmp_path / "log").read_text()), 90.0, "that it is ready")
