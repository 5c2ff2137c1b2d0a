"""Break a good recording in many ways that users meet; what does `longreach estimate` make of each?

    python benchmarks/broken_recordings.py [--seed N] [--duration S] [WAY ...]

The drive is simulated (kinematic, mecanum): odometry, an IMU, a scanner, all in one MCAP with its tf. Of each way the
table shows the fused path's position and heading error (RMSE against the truth, aligned), those of the best honest
input (wheels alone or LIDAR alone of the whole recording, of those that are not broken), and whether a remark names
the cause. A row is a miss where the path is more than twice as bad (+ 2 mm, 0.1°) and nothing is said; then the exit
code is 1.
"""

import argparse
import copy
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from longreach.app.estimate import estimate
from longreach.errors import LongreachError
from longreach.evaluation.alignment import associate
from longreach.evaluation.metrics import ate
from longreach.geometry import se2, se3, so3
from longreach.io import messages
from longreach.io.bag_writer import new_bag, type_store
from longreach.io.recording import read_recording
from longreach.io.robots import load_robot
from longreach.measurement import Odometry
from longreach.odometry.dead_reckoning import integrate
from longreach.odometry.wheel import wheel_odometry
from longreach.robot.description import ImuSensor, RobotDescription, Topics
from longreach.sim.kinematic import make_recording
from longreach.trajectory import PoseTrajectory

START = 1_700_000_000.0
ODOM, SCAN, IMU, TF = "/odom", "/scan", "/imu", "/tf_static"
TYPES = type_store(False).types
ROBOT = RobotDescription(
    name="mybot", drive="omnidirectional", topics=Topics(wheels=ODOM, lidar=SCAN, imu=IMU), imu=ImuSensor()
)


@dataclass
class Row:
    """One message on its way into the bag: time of recording [s], topic, message."""

    at: float
    topic: str
    message: Any


Rows = list[Row]


def good(seed: int, duration: float) -> tuple[Rows, PoseTrajectory]:
    """Return the messages of a good recording, and the truth."""
    thing = load_robot("thing")
    made = make_recording(thing, seed=seed, duration=duration, lidar_rate=10.0, beams=181)
    steps = wheel_odometry(made.wheels, thing.description).measurements
    path = integrate(steps, [record.stamp for record in made.wheels])
    rows = [Row(START, TF, messages.transforms(TYPES, START, made.mounts))]
    dt = np.diff(path.clock, prepend=path.clock[0] - 0.02)
    twists = se2.log(se2.between(np.vstack([path.poses[:1], path.poses[:-1]]), path.poses)) / dt[:, None]
    for stamp, pose, twist in zip(path.clock.tolist(), path.poses, twists, strict=True):
        message = messages.odometry(TYPES, START + stamp, Odometry(stamp, pose, twist))
        rows.append(Row(START + stamp + 0.002, ODOM, message))
    for scan in made.scans:
        rows.append(Row(START + scan.stamp + 0.01, SCAN, messages.laser_scan(TYPES, START + scan.stamp, scan)))
    for reading in made.imu:
        rows.append(Row(START + reading.stamp + 0.003, IMU, messages.imu(TYPES, START + reading.stamp, reading)))
    truth = made.truth
    assert truth is not None
    return sorted(rows, key=lambda row: row.at), PoseTrajectory(truth.stamps + START, truth.poses)


WAYS: dict[str, tuple[Callable[[Rows], object], str, str]] = {}


def way(broken: str, words: str) -> Callable[[Callable[[Rows], object]], Callable[[Rows], object]]:
    """Register a way to break a recording: which inputs are no longer honest, and words that name the cause."""

    def register(function: Callable[[Rows], object]) -> Callable[[Rows], object]:
        WAYS[function.__name__] = function, broken, words
        return function

    return register


def of(rows: Rows, *topics: str) -> Rows:
    return [row for row in rows if row.topic in topics]


def set_stamp(row: Row, stamp: float) -> None:
    row.message.header.stamp = messages.header(TYPES, stamp, "").stamp


def stamp_of(row: Row) -> float:
    return row.message.header.stamp.sec + 1e-9 * row.message.header.stamp.nanosec


def shift(rows: Rows, by: float, after: float = -np.inf) -> None:
    for row in rows:
        if row.topic != TF and row.at >= after:
            set_stamp(row, stamp_of(row) + by)


def half(rows: Rows) -> float:
    return 0.5 * (rows[0].at + rows[-1].at)


@way("", "")
def nothing(rows):
    pass


@way("imu", "another clock")
def imu_clock_since_boot(rows):
    shift(of(rows, IMU), 75.3 - START)


@way("", "another clock")
def lidar_clock_an_hour_ahead(rows):
    shift(of(rows, SCAN), 3600.0)


@way("", "another clock")
def wheels_clock_half_a_second_ahead(rows):
    shift(of(rows, ODOM), 0.5)


@way("", "was set by")
def all_clocks_set_back_by_five_seconds(rows):
    shift(rows, -5.0, half(rows))


@way("", "was set by")
def all_clocks_set_forward_by_an_hour(rows):
    shift(rows, 3600.0, half(rows))


@way("", "was set by")
def lidar_clock_set_back_by_twenty_seconds(rows):
    shift(of(rows, SCAN), -20.0, half(rows))


@way("", "clocks differ")
def lidar_stamps_two_seconds_late(rows):
    shift(of(rows, SCAN), 1.9)
    for row in of(rows, SCAN):
        row.at += 1.9


@way("", "clocks differ")
def lidar_stamps_half_a_second_early(rows):
    shift(of(rows, SCAN), -0.5)


@way("", "recorded")
def lidar_recorded_two_seconds_late(rows):
    for row in of(rows, SCAN):
        row.at += 1.9


@way("", "no stamp")
def headers_without_stamps(rows):
    for row in rows:
        if row.topic != TF:
            set_stamp(row, 0.0)


@way("", "equal")
def imu_clock_of_whole_tenths(rows):
    for row in of(rows, IMU):
        set_stamp(row, np.floor(10.0 * stamp_of(row)) / 10.0)


@way("", "equal")
def wheels_in_blocks_with_one_stamp(rows):
    odometry = of(rows, ODOM)
    for i, row in enumerate(odometry):
        last = odometry[min(i // 5 * 5 + 4, len(odometry) - 1)]
        set_stamp(row, stamp_of(last))
        row.at = last.at + 1e-6 * i


@way("", "backwards")
def stamps_that_run_backwards_now_and_then(rows):
    rng = np.random.default_rng(1)
    for row in of(rows, ODOM, SCAN):
        if rng.random() < 0.05:
            set_stamp(row, stamp_of(row) - 0.15)


@way("", "equal to the one before")
def every_third_message_twice(rows):
    rows.extend([Row(row.at + 1e-4, row.topic, row.message) for row in rows[1::3]])


@way("", "gaps")
def lidar_silent_for_five_seconds(rows):
    t = half(rows)
    rows[:] = [row for row in rows if not (row.topic == SCAN and t <= row.at < t + 5.0)]


@way("", "")
def frames_with_a_prefix_in_tf(rows):
    for transform in rows[0].message.transforms:
        transform.child_frame_id = f"robot1/{transform.child_frame_id}"
        transform.header.frame_id = f"robot1/{transform.header.frame_id}"


@way("", "")
def frames_with_a_leading_slash(rows):
    for row in of(rows, SCAN, IMU):
        row.message.header.frame_id = f"/{row.message.header.frame_id}"


@way("lidar", "mounted|LIDAR stands")
def no_mount_of_the_laser(rows):
    rows[0].message.transforms[:] = [t for t in rows[0].message.transforms if t.child_frame_id != "front_laser"]


@way("lidar", "mounted|LIDAR stands")
def no_mount_of_a_laser_that_looks_backwards(rows):
    no_mount_of_the_laser(rows)
    for row in of(rows, SCAN):  # as seen by a scanner that is turned by 180°
        row.message.angle_min, row.message.angle_max = row.message.angle_min + np.pi, row.message.angle_max + np.pi


@way("wheels", "carried to")
def odometry_of_a_mounted_camera(rows):
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(0.1, -0.2, np.pi), np.array([0.4, 0.1, 0.3]))
    rows[0].message.transforms.extend(messages.transforms(TYPES, START, {"camera": T}).transforms)
    for row in of(rows, ODOM):
        base = se2.to_se3(pose_of(row))
        row.message.pose.pose = messages.tool_pose(TYPES, START, se3.inverse(T) @ base @ T).pose
        row.message.child_frame_id = "camera"


@way("lidar", "upside down")
def laser_upside_down(rows):
    for row in of(rows, SCAN):
        row.message.ranges = row.message.ranges[::-1].copy()


def turn_imu(rows: Rows, R: np.ndarray) -> None:
    for row in of(rows, IMU):
        for vector in (row.message.angular_velocity, row.message.linear_acceleration):
            vector.x, vector.y, vector.z = (R.T @ np.array([vector.x, vector.y, vector.z])).tolist()


@way("imu", "downwards|put right")
def imu_upside_down(rows):
    turn_imu(rows, so3.from_roll_pitch_yaw(np.pi, 0.0, 0.0))


@way("imu", "leans")
def imu_with_its_y_axis_up(rows):
    turn_imu(rows, so3.from_roll_pitch_yaw(np.pi / 2, 0.0, 0.0))


@way("imu", "downwards")
def imu_gives_gravity_with_the_wrong_sign(rows):
    for row in of(rows, IMU):
        a = row.message.linear_acceleration
        a.x, a.y, a.z = -a.x, -a.y, -a.z


def scale_imu(rows: Rows, turn: float, felt: float) -> None:
    for row in of(rows, IMU):
        for vector, by in ((row.message.angular_velocity, turn), (row.message.linear_acceleration, felt)):
            vector.x, vector.y, vector.z = by * vector.x, by * vector.y, by * vector.z


for name, words, *scales in (
    ("accelerations_of_zero", "no accelerometer", 1.0, 0.0),
    ("accelerations_in_g", "in g", 1.0, 1 / 9.80665),
    ("gyro_in_degrees", "degrees", 180.0 / np.pi, 1.0),
    ("gyro_with_the_wrong_sign", "sign", -1.0, 1.0),
    ("gyro_of_twice_the_scale", "times as far", 1.9, 1.0),
    ("gyro_of_zero", "no gyro", 0.0, 1.0),
):
    WAYS[name] = partial(scale_imu, turn=scales[0], felt=scales[1]), "imu", words


@way("", "")
def accelerations_marked_as_not_measured(rows):
    for row in of(rows, IMU):
        row.message.linear_acceleration_covariance[0] = -1.0


@way("imu", "no gravity")
def accelerations_without_gravity(rows):
    for row in of(rows, IMU):
        row.message.linear_acceleration.z -= 9.81


@way("imu", "not finite")
def imu_that_is_not_a_number_now_and_then(rows):
    for row in of(rows, IMU)[::20]:
        row.message.angular_velocity.z = np.nan


@way("lidar", "millimetres")
def ranges_in_millimetres(rows):
    for row in of(rows, SCAN):
        row.message.ranges = (1000.0 * row.message.ranges).astype(np.float32)
        row.message.range_max = 1000.0 * min(row.message.range_max, 1e6)


@way("lidar", "degrees")
def angles_in_degrees(rows):
    for row in of(rows, SCAN):
        row.message.angle_min, row.message.angle_max = np.degrees(
            [row.message.angle_min, row.message.angle_max]
        ).tolist()
        row.message.angle_increment = float(np.degrees(row.message.angle_increment))


@way("", "left out")
def one_scan_of_infinite_angles(rows):
    message = of(rows, SCAN)[0].message
    message.angle_increment, message.ranges = np.inf, message.ranges[:1]


@way("", "left out")
def scans_that_are_empty_now_and_then(rows):
    for row in of(rows, SCAN)[::7]:
        row.message.ranges = row.message.ranges[:0]


@way("", "differ from scan to scan")
def beams_that_differ_from_scan_to_scan(rows):
    rng = np.random.default_rng(2)
    for row in of(rows, SCAN):
        first, last = rng.integers(0, 10), 181 - rng.integers(0, 10)
        row.message.angle_min += float(first) * row.message.angle_increment
        row.message.ranges = row.message.ranges[first:last]


@way("", "robot itself")
def beams_that_see_the_robot(rows):
    rng = np.random.default_rng(3)
    for row in of(rows, SCAN):
        row.message.ranges[:25] = 0.3 + rng.normal(0, 0.004, 25)
        row.message.ranges[-15:] = 0.4 + rng.normal(0, 0.004, 15)


@way("", "")
def a_largest_range_that_is_not_a_number(rows):
    for row in of(rows, SCAN):
        row.message.range_max = np.nan


@way("lidar", "repeat")
def a_scanner_that_hangs_for_five_seconds(rows):
    t, scans = half(rows), of(rows, SCAN)
    stuck = next(row for row in scans if row.at >= t)
    for row in scans:
        if t <= row.at < t + 5.0:
            row.message.ranges = stuck.message.ranges.copy()


@way("", "sweep")
def a_time_increment_in_milliseconds(rows):
    for row in of(rows, SCAN):
        row.message.time_increment = 1e3 * 0.025 / 181


def pose_of(row: Row) -> np.ndarray:
    p, q = row.message.pose.pose.position, row.message.pose.pose.orientation
    return np.array([p.x, p.y, 2.0 * np.arctan2(q.z, q.w)])


def change_odometry(rows: Rows, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change the steps (n, 3) between the poses."""
    odometry = of(rows, ODOM)
    poses = np.array([pose_of(row) for row in odometry])
    steps = change(se2.log(se2.between(poses[:-1], poses[1:])))
    pose = poses[0]
    for row, xi in zip(odometry[1:], steps, strict=True):
        pose = se2.compose(pose, se2.exp(xi))
        row.message.pose.pose = messages.pose_stamped(TYPES, START, pose).pose


@way("wheels", "times as far|wheels turn")
def wheels_swapped_left_and_right(rows):
    change_odometry(rows, lambda xi: xi * [1.0, 1.0, -1.0])


@way("wheels", "times as far")
def wheels_of_twice_the_radius(rows):
    change_odometry(rows, lambda xi: 2.0 * xi)


@way("wheels", "times as far")
def wheels_that_turn_twice_as_far(rows):
    change_odometry(rows, lambda xi: xi * [1.0, 1.0, 2.0])


@way("wheels", "aside")
def wheels_that_go_backwards(rows):
    change_odometry(rows, lambda xi: xi * [-1.0, -1.0, 1.0])


@way("wheels", "never change")
def wheels_that_never_turn(rows):
    change_odometry(rows, lambda xi: 0.0 * xi)


@way("wheels", "neither a pose|not finite")
def odometry_that_is_not_a_number_now_and_then(rows):
    for row in of(rows, ODOM)[::20]:
        row.message.pose.pose.position.x = row.message.twist.twist.linear.x = np.nan


@way("", "jumped")
def odometry_that_begins_again(rows):
    odometry = of(rows, ODOM)
    half_way = odometry[len(odometry) // 2 :]
    start = pose_of(half_way[0])
    for row in half_way:
        pose = se2.between(start, pose_of(row))
        row.message.pose.pose = messages.pose_stamped(TYPES, START, pose).pose


@way("", "")
def covariances_that_are_nonsense(rows):
    for i, row in enumerate(of(rows, ODOM)):
        row.message.pose.covariance[:] = (np.nan, 1e12, 0.0)[i % 3]
        row.message.twist.covariance[:] = (1e12, np.nan, 0.0)[i % 3]


def errors(path: PoseTrajectory, truth: PoseTrajectory) -> tuple[float, float]:
    """Return RMSE of position [m] and heading [deg] after the first pose is laid on the truth's."""
    found = ate(associate(path, truth, 0.2))
    assert found.heading is not None
    position, heading = (float(np.sqrt(np.mean(np.square(one)))) for one in (found.position, found.heading))
    return position, float(np.degrees(heading))


def main() -> int:
    """Break, estimate, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ways", nargs="*", help="which ways; all where none is named")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=30.0)
    parser.add_argument("--remarks", action="store_true", help="print all remarks")
    options = parser.parse_args()
    rows, truth = good(options.seed, options.duration)
    honest: dict[str, tuple[float, float]] = {}
    missed = 0
    print("| broken | fused [m / °] | best honest input [m / °] | named |")
    print("|---|---|---|---|")
    for name in dict.fromkeys(["nothing", *(options.ways or WAYS)]):
        function, broken, words = WAYS[name]
        changed = copy.deepcopy(rows)
        function(changed)
        changed.sort(key=lambda row: row.at)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "drive.mcap"
            with new_bag(path) as bag:
                for row in changed:
                    bag.write(row.topic, row.message, row.at)
            try:
                result = estimate(read_recording(path, ROBOT), ROBOT, truth=truth)
            except LongreachError as error:
                print(f"| {name.replace('_', ' ')} | refused: {error} | | yes |")
                continue
        if name == "nothing":
            honest = {kind: errors(result.trajectories[kind], truth) for kind in ("wheels", "lidar")}
        left = [honest[kind] for kind in honest if kind not in broken] or list(honest.values())
        best = min(one[0] for one in left), min(one[1] for one in left)
        fused = errors(result.trajectories["fused"], truth)
        said = any(word and word in remark for word in words.split("|") for remark in result.remarks)
        bad = fused[0] > 2.0 * best[0] + 0.002 or fused[1] > 2.0 * best[1] + 0.1
        missed += bad and not said
        verdict = "yes" if said else "NO" if bad else "MISSING" if words else "-"
        shown = [f"{one[0]:.4f} / {one[1]:.3f}" for one in (fused, best)]
        cells = name.replace("_", " "), shown[0] + (" (worse)" if bad else ""), shown[1], verdict
        print(f"| {' | '.join(cells)} |", flush=True)
        if options.remarks or verdict in ("NO", "MISSING"):
            for remark in result.remarks:
                print(f"    {remark}", flush=True)
    print(f"\n{missed} misses of {len(WAYS) - 1}")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
