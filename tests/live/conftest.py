"""A robot that is served by a process of its own, clients of it, and certificates."""

import subprocess

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
    """Folders of certificates: `ours`, `strange` (signed by somebody else) and `bare` (none of a client)."""
    folders = {name: tmp_path_factory.mktemp(name) for name in ("ours", "strange", "bare")}

    def openssl(folder, *words):
        subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)

    for name in ("ours", "strange"):
        folder = folders[name]
        new = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
        try:
            openssl(folder, "req", "-x509", *new, "-keyout", "ca.key", "-out", "ca.pem", "-subj", f"/CN={name}")
        except FileNotFoundError:
            pytest.skip("openssl is not installed")
        (folder / "more").write_text("subjectAltName=IP:127.0.0.1\nbasicConstraints=CA:FALSE\n")
        for who in ("server", "client"):
            openssl(folder, "req", *new, "-keyout", f"{who}.key", "-out", f"{who}.csr", "-subj", f"/CN={who}")
            openssl(folder, "x509", "-req", "-in", f"{who}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial",
                    "-extfile", "more", "-out", f"{who}.pem")  # fmt: skip
    for name in ("strange", "bare"):  # they know our authority
        (folders[name] / "ca.pem").write_bytes((folders["ours"] / "ca.pem").read_bytes())
    return folders
