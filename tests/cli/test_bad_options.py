"""An option that cannot be is said in a sentence before kernels are compiled, data are read or a robot is called."""

import os
import socket
import subprocess
import sys

import pytest

_WRONG = {
    "run": [
        ("dancing", "There is no experiment 'dancing'"),
        ("localization --seeds 0", "seeds is 0"),
        ("localization --seed -1", "seed is -1"),
        ("localization --floor lava", "lava"),
        ("localization --floor 0", "friction above 0"),
        ("localization --duration nan", "duration is nan"),
        ("localization --duration inf", "duration is inf"),
        ("localization --world office", "The world office has no ways to drive along"),
        ("localization --world moon", "moon is neither a world"),
        ("dual-trajectory --length 0", "length is 0"),
        ("dual-trajectory --length inf", "length is inf"),
        ("dual-trajectory --world moon", "moon is neither a world"),
        ("manipulability --objective beauty", "objective is 'beauty'"),
        ("manipulability --world moon", "moon is neither a world"),
        ("dual-trajectory --out a.txt", "a.txt is a file"),
        ("dual-trajectory --out a.txt/out", "cannot be written"),
    ],
    "plan": [
        ("dual-trajectory --robot moon --out out", "moon is neither a robot"),
        ("dual-trajectory --robot thing --out out --method luck", "luck"),
        ("dual-trajectory --robot thing --out out --length -1", "length is -1"),
        ("dual-trajectory --robot thing --out out --duration nan", "duration is nan"),
        ("dual-trajectory --robot thing --out out --waypoints 1", "waypoints is 1"),
        ("dual-trajectory --robot thing --out out --tool nose", "nose"),
        ("dual-trajectory --robot thing --out out --problem nowhere.yaml", "nowhere.yaml is not there"),
        ("nowhere.csv --robot thing --out out", "nowhere.csv"),
        ("dual-trajectory --robot thing --out a.txt/out", "cannot be written"),
    ],
    "estimate": [
        ("nowhere.bag --robot moon --out out", "moon is neither a robot"),
        ("nowhere.bag --robot thing --out out --sources smell", "--sources"),
        ("nowhere.bag --robot thing --out out --fix-sigma 0", "--fix-sigma is 0"),
        ("nowhere.bag --robot thing --out out --fix-period -1", "--fix-period is -1"),
        ("nowhere.bag --robot thing --out out --fixes nowhere.tum", "nowhere.tum is not there"),
        ("nowhere.bag --robot thing --out out --config nowhere.yaml", "nowhere.yaml is not there"),
        ("nowhere.bag --robot thing --out a.txt/out", "cannot be written"),
        ("nowhere.bag --robot thing --out out --topic /scan", "--topic /scan is not of the form NAME=VALUE"),
        ("nowhere.bag --robot thing --out out --topic imu=/a --topic imu=/b", "--topic is given twice for imu"),
    ],
    "info": [("nowhere.bag --topic lidar=", "--topic lidar= is not of the form NAME=VALUE, as lidar=/scan")],
    "evaluate": [
        ("nowhere.tum --out a.txt/out", "cannot be written"),
        ("nowhere.tum --out out --assume wxyz", "--assume wxyz is not of the form NAME=VALUE, as quaternion=wxyz"),
    ],
    "serve": [
        ("--robot moon", "moon is neither a robot"),
        ("--hardware steam", "There is no hardware 'steam'"),
        ("--world moon", "moon is neither a world"),
        ("--address 127.0.0.1:99999", "a port is a number from 1 to 65535"),
        ("--address 127.0.0.1:0", "a port is a number from 1 to 65535"),
        ("--address here", "write it as host:port"),
        ("--seed -1", "--seed"),
        ("--duration -1", "--duration is -1; give a number of seconds"),
        ("--duration nan", "--duration is nan; give a number of seconds"),
        ("--duration inf", "--duration is inf; give a number of seconds"),
        ("--record a.txt/run.mcap", "cannot be written"),
    ],
    "connect": [
        ("127.0.0.1:99999", "a port is a number from 1 to 65535"),
        ("--duration 2 --move-to 0,0", "--duration is for watching and for --velocity; leave it out with --move-to"),
        ("--resume", "--resume is for --plan"),
        ("--method luck", "luck"),
        ("--velocity 1,2", "--velocity takes 3 numbers"),
        ("--velocity nan,0,0", "--velocity takes 3 numbers"),
        ("--tool-by 1", "--tool-by takes 3 numbers"),
        ("--move-to home", "--move-to takes numbers"),
        ("--plan nowhere.csv", "nowhere.csv"),
        ("--duration -1", "--duration is -1; give a number of seconds"),
        ("--duration nan", "--duration is nan; give a number of seconds"),
        ("--duration inf", "--duration is inf; give a number of seconds"),
    ],
    "view": [
        ("", "Give either a recording"),
        ("run.bag --port 99999", "--port"),
        ("run.bag --port -1", "--port"),
        ("--connect 127.0.0.1:7447 --port 99999", "--port"),
        ("--connect 127.0.0.1:99999", "a port is a number from 1 to 65535"),
        ("--connect here", "write it as host:port"),
        ("a.txt --robot moon", "moon is neither a robot"),
        ("run.bag --duration -1", "--duration is -1; give a number of seconds"),
        ("run.bag --duration nan", "--duration is nan; give a number of seconds"),
        ("run.bag --duration inf", "--duration is inf; give a number of seconds"),
        ("run.bag --export a.txt/run.html", "cannot be written"),
        ("run.bag --export folder", "folder is a folder; give a file for the scene, as folder/run.html."),
        ("run.bag --token-file token", "--token-file and --certificates are for a robot's network"),
        ("run.bag --certificates folder", "--token-file and --certificates are for a robot's network"),
        ("--connect 127.0.0.1:7447 --export run.html", "--export, --robot and --estimate are for a recording"),
        ("--connect 127.0.0.1:7447 --robot thing", "--export, --robot and --estimate are for a recording"),
        ("--connect 127.0.0.1:7447 --estimate folder", "--export, --robot and --estimate are for a recording"),
    ],
}  # fmt: skip


@pytest.fixture
def nothing_begins(monkeypatch, tmp_path):
    """Whoever compiles kernels, reads a recording or connects to a robot fails the test."""

    def begin(*arguments, **more):
        raise AssertionError("it has begun")

    for name in (
        "longreach.app.warmup.warm_up",
        "longreach.app.inputs.read_recording",
        "longreach.live.protocol.transport.zenoh",
        "longreach.app.evaluate.evaluate_files",
    ):
        monkeypatch.setattr(name, begin)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.txt").write_text("a file")
    (tmp_path / "folder").mkdir()


@pytest.mark.usefixtures("nothing_begins")
@pytest.mark.parametrize(
    ("verb", "options", "words"), [(verb, *case) for verb, cases in _WRONG.items() for case in cases]
)
def test_a_wrong_option_is_said_before_anything_begins(run, verb, options, words):
    answer = run(verb, *options.split())
    assert answer.code == 2
    assert answer.out == ""
    said = " ".join(answer.err.replace("│", " ").split())  # a usage error has a box around it
    assert words in said
    assert "Traceback" not in answer.err


@pytest.mark.usefixtures("nothing_begins")
@pytest.mark.parametrize("what", [["run.bag"], ["--connect", "127.0.0.1:7447"]], ids=str)
def test_a_port_that_is_in_use_is_a_sentence(run, what):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        answer = run("view", *what, "--port", port)
    assert answer.code == 2
    assert f"No page can be served at port {port}: " in answer.sentence


def test_a_wrong_option_compiles_nothing(tmp_path):
    """In a process of its own, with an empty folder for kernels: after it the folder is empty still."""
    command = [sys.executable, "-m", "longreach", "run", "dual-trajectory", "--world", "moon"]
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=env)
    assert ended.returncode == 2
    assert ended.stderr.startswith("longreach: moon is neither a world")
    assert not list(tmp_path.rglob("*.nbi"))
