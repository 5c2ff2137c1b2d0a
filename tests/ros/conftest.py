"""A real ROS 1 on loopback: a master of the tests' own on a free port, and nodes, each in a process of its own."""

import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
from ros_nodes import free_port, process, this_node

ROSMASTER = Path("/usr/bin/rosmaster")


@pytest.fixture(scope="session")
def ros(tmp_path_factory):
    """The environment of a ROS whose master runs."""
    if not ROSMASTER.is_file():
        pytest.skip("there is no ROS 1 here; install Debian's python3-rospy and python3-rosmaster")
    home, port = tmp_path_factory.mktemp("ros"), free_port()
    given = {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_IP": "127.0.0.1",
        "ROS_HOME": str(home),
        "ROS_LOG_DIR": str(home / "log"),
    }
    environment = {**os.environ, **given}
    with process([ROSMASTER, "--core", "-p", port], environment):
        yield environment


@pytest.fixture(scope="session")
def other(ros):
    """Run a function in a process that is a node itself, for rospy's threads and sockets outlive its tests."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, initializer=this_node, initargs=(ros,)) as pool:
        yield lambda function, *arguments: pool.submit(function, *arguments).result(60.0)


@pytest.fixture(scope="session")
def nodes(ros):
    """Start `longreach ros …` as a process."""
    return lambda *arguments: process([sys.executable, "-m", "longreach", "ros", *arguments], ros)
