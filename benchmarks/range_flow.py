"""Range flow: time a scan at 360 and 1081 beams, and accuracy on the real logs by the relations metric.

    python benchmarks/range_flow.py [--data FOLDER]

Bars: rf2o's C++ takes 0.070 ms a scan at 360 beams and 0.187 ms at 1081; on Intel its relations spanning ≤ 5 s have a
mean of 0.0256 m / 0.262° and a median of 0.0133 m / 0.195°. No pip-installable peer exists to run beside it.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np

from longreach.evaluation.relations import relation_errors, summary
from longreach.geometry import se2
from longreach.io.config import load_description
from longreach.io.recording import read_recording
from longreach.io.relations import read_relations
from longreach.measurement import Recording
from longreach.odometry.matchers.range_flow import RangeFlow, RangeFlowConfig, lidar_odometry
from longreach.odometry.matchers.scan_matcher import ScanMatch
from longreach.odometry.scan_geometry import scan_geometry
from longreach.sim.kinematic import make_recording
from longreach.trajectory import PoseTrajectory


def milliseconds_a_scan(recording: Recording, T_base_laser: np.ndarray) -> float:
    """Return the median time of one match, everything included from LaserScan to pose and covariance."""
    geometry, matcher = scan_geometry(recording.scans[0], T_base_laser, 5), RangeFlow(RangeFlowConfig())
    fit, last, times = None, None, []
    for scan in recording.scans:
        began = time.perf_counter()
        features = matcher.features(scan, geometry, np.zeros(3), 0.0)
        if last is not None:
            fit = matcher.match(features, last, geometry, None)
            assert not isinstance(fit, str), fit
        last, _ = matcher.extended(last, features, fit)
        times.append(time.perf_counter() - began)
    return 1e3 * float(np.median(times[10:]))


def path(recording: Recording, matches: tuple[ScanMatch, ...]) -> PoseTrajectory:
    """Chain the matches; a failed one is no motion."""
    poses = [np.zeros(3)]
    for match in matches:
        poses.append(poses[-1] if match.measurement is None else se2.compose(poses[-1], match.measurement.pose))
    clock = np.array([scan.stamp for scan in recording.scans])
    return PoseTrajectory(recording.as_recorded(clock), np.array(poses), clock=clock)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=os.environ.get("LONGREACH_DATA"))
    data = parser.parse_args().data
    thing = load_description("thing")
    assert thing.lidar is not None
    T = thing.lidar.mount.matrix()
    for beams, bar in ((360, 0.08), (1081, 0.20)):
        recording = make_recording(seed=1, duration=20.0, robot=thing, beams=beams, lidar_rate=40.0)
        print(f"{beams:5d} beams: {milliseconds_a_scan(recording, T):.3f} ms a scan (bar {bar:.2f})")
    if data is None:
        print("no accuracy without --data or LONGREACH_DATA")
        return
    for name, recording_file in (("intel", "intel.clf.bz2"), ("aces", "aces.clf.bz2")):
        robot = load_description(name)
        assert robot.lidar is not None
        recording = read_recording(Path(data) / name / recording_file, robot)
        began = time.perf_counter()
        matches = lidar_odometry(recording.scans, robot.lidar.mount.matrix())
        each = 1e3 * (time.perf_counter() - began) / len(recording.scans)
        relations = read_relations(Path(data) / name / f"{name}.relations")
        s = summary(relation_errors(path(recording, matches), *relations), longest_span=5.0)
        print(
            f"{name}: mean {s.translation.mean:.4f} m / {np.degrees(s.rotation.mean):.3f}°, "
            f"median {s.translation.median:.4f} m / {np.degrees(s.rotation.median):.3f}°, {each:.3f} ms a scan"
        )


if __name__ == "__main__":
    main()
