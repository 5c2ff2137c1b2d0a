"""A short drive along a wall, a client that plays a robot, and a browser."""

import signal
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from live_networks import Served
from rosbags.typesys import Stores, get_typestore

import longreach as lr
from longreach.configuration import ConfigurationTrajectory
from longreach.control.interpolation import sample
from longreach.io import messages
from longreach.io.bag_recorder import Recorder
from longreach.measurement import JointState, LaserScan, Odometry, Recording
from longreach.trajectory import PoseTrajectory
from longreach.view.replay import assemble

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
_CHROMIUM = "/usr/bin/chromium"
_FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@pytest.fixture(scope="package")
def thing():
    return lr.load_robot("thing")


@pytest.fixture(scope="package")
def drive(thing):
    """Two seconds at 0.5 m/s towards a wall that stands 2 m before the laser at the end; wheels drift sideways."""
    t = np.linspace(0.0, 2.0, 51)
    poses = np.column_stack([0.5 * t, 0 * t, 0 * t])
    drifted = np.column_stack([0.5 * t, 0.05 * t, 0 * t])
    fused = PoseTrajectory(t, poses, np.tile(np.diag([1e-4, 4e-4, 1e-6]), (51, 1, 1)))
    angles = -0.5 + 0.01 * np.arange(101)
    scans = [LaserScan(s, (2.0 - 0.5 * s) / np.cos(angles), -0.5, 0.01) for s in (t[:-1] + 0.013).tolist()]
    names = thing.joint_names[thing.arm]
    home = thing.home[thing.arm]
    joints = [JointState(s, names, home + 0.1 * s * np.eye(6)[0], 0.1 * np.eye(6)[0], np.zeros(0)) for s in t.tolist()]
    recording = Recording(name="drive", scans=tuple(scans), joints=tuple(joints))
    ways = {"fused": fused, "wheels": PoseTrajectory(t, drifted), "truth": PoseTrajectory(t, poses)}
    return assemble("drive", thing, recording, ways)


class Pretender:
    """A client whose robot does at once what it is asked."""

    def __init__(self, robot):
        self.robot, self.scan, self.age, self.orders = robot, None, 0.0, []
        self._q, self._start, self._plan, self.stopped = robot.home.copy(), time.monotonic(), None, 0.0
        self._begun, self.holds, self.covariance = 0.0, False, 1e-4 * np.eye(3)
        self.reason, self.holder, self.why = "The client says stop.", "", ""
        self.role = "operator"
        self.limited, self.minds_obstacles, self.remarks = "", True, ()

    @property
    def state(self):
        if self._plan is not None and not self.stopped:
            at = min(time.monotonic() - self._begun, self._plan.duration)
            self._q = sample(self._plan, np.array([self._plan.stamps[0] + at]))[0][0]
        zero = np.zeros(self.robot.dof)
        return SimpleNamespace(
            stamp=time.monotonic() - self._start, q=self._q, velocity=zero, covariance=self.covariance,
            wheels=self._q[:3], truth=self._q[:3], tool_truth=None, goal="hold", progress=0.0, loop_time=1e-3,
            stop=self.reason if self.stopped else "", latched=bool(self.stopped), holder=self.holder,
            joints={}, cause="emergency stop" if self.stopped else "", stopped_by="page" if self.stopped else "",
            stopped_at=self.stopped - self._start if self.stopped else 0.0, why=self.why,
            limited=self.limited, minds_obstacles=self.minds_obstacles, remarks=self.remarks,
        )  # fmt: skip

    def on_state(self, callback):
        ended = threading.Event()

        def tell():
            while not ended.wait(0.01):
                callback(self.state)

        thread = threading.Thread(target=tell, daemon=True)
        thread.start()
        return lambda: (ended.set(), thread.join())

    def on_scan(self, callback):
        return lambda: None

    def record(self, path):
        """Record some of what a robot says: wheels and the arm."""
        recorder, names = Recorder(path), self.robot.joint_names[self.robot.arm]

        def write(state):
            odometry = messages.odometry(TYPES, state.stamp, Odometry(state.stamp, np.array(state.wheels)))
            joints = messages.joint_state(TYPES, state.stamp, names, state.q[self.robot.arm])
            for topic, message in ((self.robot.description.topics.wheels, odometry), ("/arm/joint_states", joints)):
                payload = bytes(STORE.serialize_cdr(message, message.__msgtype__))
                recorder.write(topic, message.__msgtype__, payload, state.stamp)

        recorder.ended = self.on_state(write)
        return recorder

    def plan(self, goal, method):
        self.orders.append((method, goal))
        q = np.stack([self._q, self._q + 0.05])
        return ConfigurationTrajectory(np.array([0.0, 0.3]), q, self.robot.joint_names)

    def execute(self, trajectory, wait=True):
        self._plan, self._begun = trajectory, time.monotonic()

    def reach(self, T):
        self.orders.append(("reach", T))

    def velocity(self, arm=None, base=None):
        self.orders.append(("velocity", base))

    def hold(self):
        self.orders.append(("hold", None))

    def stop(self):
        self.stopped = time.monotonic()

    def reset(self):
        self.stopped = 0.0

    def release(self):
        self.holds = False


@pytest.fixture
def pretender(thing):
    return Pretender(thing)


@pytest.fixture(scope="package")
def all_served():
    """The robots that tests have served; all end with the package."""
    robots = []
    yield robots
    for one in robots:
        one.process.send_signal(signal.SIGCONT)
        one.end()


@pytest.fixture
def served(all_served, tmp_path_factory):
    """A kinematic robot that another process serves: one for all tests, until one of them kills it."""
    if not all_served or all_served[-1].process.poll() is not None:
        all_served.append(Served(tmp_path_factory.mktemp("served")).ready())
    return all_served[-1]


@pytest.fixture
def client(served):
    """The page's client, that leaves a robot which stands and may be commanded."""
    with lr.connect(served.address, name="page") as connected:
        yield connected
        connected.reset()
        connected.hold()


@pytest.fixture
def server():
    pytest.importorskip("viser")
    from longreach.view.page import open_page

    opened = open_page(port=0)
    yield opened
    opened.stop()


@pytest.fixture
def running():
    """Run loops beside the test."""
    until, threads = threading.Event(), []

    def run(loop):
        threads.append(threading.Thread(target=loop, args=(until,), daemon=True))
        threads[-1].start()

    yield run
    until.set()
    for thread in threads:
        thread.join()


@pytest.fixture(scope="package")
def browser():
    playwright = pytest.importorskip("playwright.sync_api")
    if not Path(_CHROMIUM).exists():
        pytest.skip(f"There is no Chromium at {_CHROMIUM}.")
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=_CHROMIUM, headless=True, args=_FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture
def page(browser):
    """A page of phone width whose errors are kept in `page.errors`."""
    opened = browser.new_page(viewport={"width": 390, "height": 480}, device_scale_factor=0.5)  # a fourth of the pixels
    opened.set_default_timeout(30_000)
    errors = opened.errors = []
    opened.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    opened.on("pageerror", lambda error: errors.append(str(error)))
    yield opened
    opened.close()
