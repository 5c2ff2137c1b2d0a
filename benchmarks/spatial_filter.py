"""The 15-state filter in space: time of predict + correct of a three-number twist, in a compiled run over a recording.

    python benchmarks/spatial_filter.py [--repeats N]

Bars: robot_localization's C++ core takes 4.2 µs (EKF) and 9.8 µs (UKF). It does not install from PyPI, so nothing runs
beside; the times are the least of the repeats, of the processor's own clock.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from longreach.estimation.spatial import _kernels as kernels
from longreach.estimation.spatial.online import init
from longreach.spatial_measurement import SpatialRecording
from longreach.spatial_settings import SpatialSettings

COUNT = 20_000
RATE = 50.0  # [1/s]


def table() -> tuple[np.ndarray, ...]:
    """Return twists of a robot that drives curves, vx, vy and vz of each measured."""
    t = np.arange(COUNT) / RATE
    z, H, R = np.zeros((COUNT, 6)), np.zeros((COUNT, 6, 6)), np.zeros((COUNT, 6, 6))
    z[:, 0], z[:, 1] = 1.0 + 0.1 * np.sin(t), 0.1 * np.cos(t)
    H[:, [0, 1, 2], [0, 1, 2]], R[:, [0, 1, 2], [0, 1, 2]] = 1.0, 0.01
    block, k = np.full(COUNT, 6), np.full(COUNT, 3)
    return t, block, k, np.full(COUNT, np.inf), np.zeros(COUNT), z, H, R, np.zeros((COUNT, 3))


def microseconds(settings: SpatialSettings, repeats: int) -> float:
    """Return the least time a measurement of some runs."""
    rows = table()
    ticks = np.array([rows[0][-1]])
    state, room, least = init(settings, SpatialRecording("none", ())), kernels.work_room(), np.inf
    for _ in range(repeats + 1):  # the first one compiles
        status, nis, m = np.zeros(COUNT, dtype=np.int8), np.zeros(COUNT), len(ticks)
        x, P = np.zeros(15), 0.01 * np.eye(15)
        x[9:12] = 0.01, 0.02, 0.3
        out = (status, nis, np.zeros(m), np.zeros((m, 15)), np.zeros((m, 6, 6)), np.zeros(3), x[9:12].copy())
        began = time.process_time()
        kernels.run(x, P, rows, ticks, state.model, state.control, 0.1, False, out, room)
        least = min(least, time.process_time() - began)
        assert np.all(status == kernels.USED)
        assert np.all(np.isfinite(x))
    return 1e6 * least / COUNT


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=20)
    repeats = parser.parse_args().repeats
    for as_is in (False, True):
        ekf = SpatialSettings((), as_robot_localization=as_is)
        how = ", as robot_localization" if as_is else ""
        print(f"EKF{how}: {microseconds(ekf, repeats):.2f} µs a measurement (bar 2.5)")
        print(f"UKF{how}: {microseconds(replace(ekf, filter='ukf'), repeats):.2f} µs a measurement (bar 9.8)")


if __name__ == "__main__":
    main()
