"""A real ROS 1 on loopback: a master of the tests' own on a free port, and nodes, each in a process of its own."""

import multiprocessing
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
from ros_nodes import can_import, free_port, process, this_node

from longreach.ros.package import write_package

ROSMASTER, ROSLAUNCH = Path("/usr/bin/rosmaster"), Path("/usr/bin/roslaunch")


@pytest.fixture(scope="package")
def ros(tmp_path_factory):
    """The environment of a ROS whose master runs."""
    if not ROSMASTER.is_file():
        pytest.skip("there is no ROS 1 here; install Debian's python3-rospy and python3-rosmaster")
    seen = subprocess.run([sys.executable, "-c", "from longreach.ros import wire; wire.rospy()"], capture_output=True)
    if seen.returncode:
        pytest.skip(f"this Python cannot use rospy: {seen.stderr.decode().strip().splitlines()[-1]}")
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


@pytest.fixture(scope="package")
def plain():
    """Run a function in a process that does not check shapes at run time, which an estimate takes long with."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield lambda function, *arguments: pool.submit(function, *arguments).result(60.0)


@pytest.fixture(scope="package")
def other(ros):
    """Run a function in a process that is a node itself, for rospy's threads and sockets outlive its tests."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, initializer=this_node, initargs=(ros,)) as pool:
        yield lambda function, *arguments: pool.submit(function, *arguments).result(60.0)


@pytest.fixture(scope="package")
def nodes(ros):
    """Start `longreach ros …` as a process."""
    return lambda *arguments: process([sys.executable, "-m", "longreach", "ros", *arguments], ros)


@pytest.fixture(scope="package")
def launched(ros, tmp_path_factory):
    """Start one of our launch files, found in a package that was written for it, with arguments NAME:=VALUE."""
    if not ROSLAUNCH.is_file():
        pytest.skip("there is no roslaunch here; install Debian's python3-roslaunch")
    packages = tmp_path_factory.mktemp("packages")
    write_package(packages)
    path = f"{packages}:{ros.get('ROS_PACKAGE_PATH', '')}"
    return lambda *arguments: process([ROSLAUNCH, "longreach", *arguments], {**ros, "ROS_PACKAGE_PATH": path})


@pytest.fixture
def needs(other):
    """Skip where a Python module of ROS is not there, or is another Python's."""

    def importable(module):
        if not other(can_import, module):
            pytest.skip(f"{module} of ROS cannot be imported here; install Debian's package of it")

    return importable
