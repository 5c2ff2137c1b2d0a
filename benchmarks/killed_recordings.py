"""Servers and views that are killed (SIGKILL) while they record: how much of the recording is lost.

python benchmarks/killed_recordings.py --times 20
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import longreach as lr
from longreach.io.bag_info import inspect

_ADDRESS = f"127.0.0.1:{20000 + os.getpid() % 20000}"
# What `longreach view --connect` does, with the button of the page pressed.
_VIEW = """
import sys, threading
from pathlib import Path
import longreach as lr
from longreach.view.page import open_page
from longreach.view.teleop import Teleop
with lr.connect(sys.argv[1], name="page") as client:
    teleop = Teleop(open_page(port=0), client, Path(sys.argv[2]))
    teleop.record()
    print("Recording", flush=True)
    teleop.loop(threading.Event())
"""


def started(command, word):
    """Return a process that has said a word."""
    process = subprocess.Popen([sys.executable, *map(str, command)], stdout=subprocess.PIPE, text=True)
    while word not in process.stdout.readline():
        assert process.poll() is None
    return process


def serve(*options):
    command = ["-m", "longreach", "serve", "--hardware", "kinematic", "--no-scans", "--address", _ADDRESS, *options]
    return started(command, "Serving")


def killed(process, client, rng):
    """Kill a process at some instant, and return the time of the robot's clock then [s]."""
    time.sleep(rng.uniform(0.5, 4.0))
    process.kill()
    process.wait()
    return client.state.stamp


def lost(path, last):
    """How much of a recording is missing before a time [s]; whatever is wrong with it raises something."""
    info = inspect(path)
    assert len(info.remarks) == 1
    lr.read_recording(path, lr.load_robot("thing"))
    return last - info.start - info.duration


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=20)
    times = parser.parse_args().times
    rng, servers, views = np.random.default_rng(0), [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for i in range(times):
            server = serve("--record", folder / f"{i}.mcap")
            with lr.connect(_ADDRESS, timeout=20.0) as client:
                last = killed(server, client, rng)
            servers.append(lost(folder / f"{i}.mcap", last))
        server = serve()
        with lr.connect(_ADDRESS, timeout=20.0) as client:
            for i in range(times):
                last = killed(started(["-c", _VIEW, _ADDRESS, folder / str(i)], "Recording"), client, rng)
                (path,) = (folder / str(i)).glob("*.mcap")
                views.append(lost(path, last))
        server.terminate()
        server.wait()
    for what, values in (("server", servers), ("view", views)):
        print(f"{what}: {times} kills, lost {np.median(values):.2f} s (median), {max(values):.2f} s (most)")


if __name__ == "__main__":
    main()
