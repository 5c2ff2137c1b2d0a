"""A robot that is served by a process of its own, clients of it, and certificates."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from live_networks import Served

import longreach as lr
from longreach.live.client.client import connect

_SERVED = {}  # one for all tests, until one of them ends it


@pytest.fixture(scope="package")
def thing():
    return lr.load_robot("thing")


@pytest.fixture(scope="package")
def serve(tmp_path_factory):
    """Serve a robot, as often as it is called; all end with the session."""
    all_served = []

    def start(*options, **more):
        all_served.append(Served(tmp_path_factory.mktemp("served"), *options, **more))
        return all_served[-1]

    yield start
    for served in all_served:
        if served.process.poll() is None:
            served.process.kill()
            served.process.wait()


@pytest.fixture
def served(serve, tmp_path_factory):
    """A robot that is served without a token, and recorded."""
    if "one" not in _SERVED or _SERVED["one"].process.poll() is not None:
        record = tmp_path_factory.mktemp("record") / "run.mcap"
        _SERVED["one"] = serve("--record", record)
        _SERVED["one"].record = record
    return _SERVED["one"].ready()


@pytest.fixture
def to():
    """Connect to a served robot or an address; hang up at the end."""
    clients = []

    def client(served, token=None, **more):
        clients.append(connect(getattr(served, "address", served), token, **more))
        if isinstance(served, Served):
            served.fresh = False
        return clients[-1]

    yield client
    for one in clients:
        one.close()


@pytest.fixture(scope="package")
def certificates(tmp_path_factory):
    """The folders that the document's commands make: `robot`, `operator` and `watcher`.

    And `strange`, whose certificate another authority has signed, and `bare`, which has none; both know ours.
    """
    document = (Path(__file__).parents[2] / "docs" / "live.md").read_text(encoding="utf-8")
    recipe = next(block for block in re.findall(r"^```sh\n(.*?)^```$", document, re.DOTALL | re.M) if "-CAkey" in block)
    ours, others = tmp_path_factory.mktemp("ours"), tmp_path_factory.mktemp("others")
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    for folder in (ours, others):
        subprocess.run(["sh", "-e", "-c", recipe], cwd=folder, check=True, capture_output=True)
    shutil.copy(ours / "authority" / "ca.pem", others / "operator" / "ca.pem")
    (ours / "bare").mkdir()
    shutil.copy(ours / "authority" / "ca.pem", ours / "bare")
    folders = {name: ours / name for name in ("robot", "operator", "watcher", "bare")}
    return folders | {"strange": others / "operator"}
