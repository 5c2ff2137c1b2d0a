"""A served robot whose readings are bad: a client hears the sentences of a recording, and the robot goes on."""

import threading
import time
from dataclasses import replace

import numpy as np
from live_networks import free_port, until

import longreach as lr
from longreach.live.server.server import ServerConfig
from longreach.live.server.serving import described, serve
from longreach.measurement import WheelTicks
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot


class Bad(KinematicRobot):
    """Every ninth reading of the IMU is another kind of nonsense; scans are in mm, some wheels are missing."""

    def read(self):
        def imu(one):
            kind = round(one.stamp / 0.01) % 27
            if kind == 0:
                return replace(one, angular_velocity=np.full(3, np.nan))
            return replace(one, stamp=one.stamp - 0.2) if kind == 9 else one

        def wheels(one):
            return WheelTicks(one.stamp, one.ticks[:3]) if round(one.stamp / 0.02) % 20 == 0 else one

        readings = super().read()
        scans = tuple(replace(one, ranges=1e3 * one.ranges, range_max=1e5) for one in readings.scans)
        return replace(
            readings, imu=tuple(map(imu, readings.imu)), wheels=tuple(map(wheels, readings.wheels)), scans=scans
        )


def test_bad_readings_are_said_over_the_network_counted_and_stop_nothing(thing):
    body = Bad(thing, seed=3, config=KinematicConfig(present=("wheels", "imu", "joints", "lidar")))
    address, over = f"127.0.0.1:{free_port()}", threading.Event()
    serving = threading.Thread(
        target=serve,
        args=(body, None, thing, described("thing"), ServerConfig(address), lambda: "over" if over.is_set() else ""),
    )
    serving.start()
    try:
        with _connected(address) as client:
            until(lambda: client.state.remarks, 40.0)
            said, stamp = "\n".join(client.state.remarks), client.state.stamp
            for words in (
                "messages of imu cannot be used and were left out: each has an angular velocity that is not finite",
                "messages of wheels cannot be used and were left out: each has 3 numbers for 4 wheels",
                "stamps of imu run backwards",
                "Half of the ranges are beyond",
            ):
                assert words in said
            assert sum(int(word) for word in said.split() if word.isdigit()) > 50
            until(lambda: client.state.stamp > stamp + 0.5)
            client.velocity(np.array([0.1, 0, 0, 0, 0, 0]))
            until(lambda: abs(client.state.velocity[3]) > 0.05)
    finally:
        over.set()
        serving.join(20.0)


def _connected(address):
    end = time.monotonic() + 60.0
    while True:
        try:
            return lr.connect(address, timeout=1.0)
        except lr.LongreachError:
            assert time.monotonic() < end
