"""The made recording: without faults its sensors tell the truth, with faults they are as wrong as they should be."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from longreach.errors import ConfigError
from longreach.geometry import se2
from longreach.measurement import WheelSpeeds, WheelTicks
from longreach.odometry.dead_reckoning import integrate
from longreach.odometry.wheel import wheel_odometry
from longreach.robot.bases import MecanumBase
from longreach.robot.description import Encoder, ImuSensor, Lidar, Mount, RobotDescription
from longreach.sim.drive import make_drive
from longreach.sim.kinematic import GRAVITY, SimulationConfig, make_recording, room_of
from longreach.sim.room import cast

QUIET = {"gyro_deviation": 1e-12, "gyro_bias_deviation": 0.0, "gyro_bias_walk": 0.0, "acceleration_deviation": 1e-12}
ROBOT = RobotDescription(
    name="thing",
    base=MecanumBase(wheel_radius=0.0759, half_length=0.319, half_width=0.2755),
    encoder=Encoder(counts_per_revolution=1024.0, gear=34.97),
    lidar=Lidar(frame="front_laser", mount=Mount(x=0.3932, z=0.233, yaw=0.1), range_min=0.06, range_max=10.0),
    imu=ImuSensor(frame="imu_link", mount=Mount(x=0.2085, y=-0.2902, z=0.1681, roll=np.pi / 2, yaw=0.7)),
    velocity_limits=(1.1, 1.1, 2.0),
    acceleration_limits=(2.5, 2.5, 1.0),
)
EXACT_ENCODER = ROBOT.model_copy(update={"encoder": Encoder(), "imu": ROBOT.imu.model_copy(update=QUIET)})
FAULTLESS = SimulationConfig(slip_deviation=0.0, burst_rate=0.0, range_deviation=0.0)


def make(robot=ROBOT, config=None, **arguments):
    return make_recording(robot, config=config, **{"duration": 10.0, "lidar_rate": 2.0, "beams": 91, **arguments})


def wheel_path(recording, robot=ROBOT):
    return integrate(wheel_odometry(recording.wheels, robot).measurements, [w.stamp for w in recording.wheels])


def test_wheels_without_slip_integrate_to_the_truth():
    recording = make(EXACT_ENCODER, FAULTLESS, duration=20.0)
    path = wheel_path(recording, EXACT_ENCODER)
    truth, known = recording.truth.at(path.clock)
    assert known.all()
    assert_allclose(path.poses, truth, atol=1e-4)
    assert_allclose(wheel_odometry(recording.wheels, EXACT_ENCODER).slip, 0.0, atol=1e-12)


@pytest.mark.parametrize("signal", ["ticks", "speed"])
def test_ticks_and_speeds_tell_the_same_as_angles(signal):
    encoder = Encoder(signal=signal, counts_per_revolution=1024.0, gear=34.97)
    robot = ROBOT.model_copy(update={"encoder": encoder})
    recording = make(robot, FAULTLESS)
    assert isinstance(recording.wheels[0], WheelTicks if signal == "ticks" else WheelSpeeds)
    assert_allclose(wheel_path(recording, robot).poses[-1], recording.truth.poses[-1], atol=1e-3)
    if signal == "ticks":
        assert all(np.array_equal(w.ticks, np.round(w.ticks)) for w in recording.wheels)


def test_slip_makes_the_wheels_drift_about_as_far_as_their_covariance_says():
    nees = []
    for seed in range(10):
        recording = make(seed=seed, duration=20.0, lidar_rate=0.1)
        path = wheel_path(recording)
        error = se2.difference(path.poses[-1], recording.truth.poses[-1])
        nees.append(error @ np.linalg.solve(path.covariance[-1], error) / 3)
    assert 0.05 < np.mean(nees) < 1.5


def test_ranges_are_those_of_the_room_seen_from_where_the_laser_is():
    recording = make(config=FAULTLESS)
    drive = make_drive(ROBOT, 10.0, np.random.default_rng(0).spawn(4)[0])
    for scan in recording.scans:
        base, known = recording.truth.at(np.array([scan.stamp]))
        assert known.all()
        laser = se2.compose(base[0], np.array([0.3932, 0.0, 0.1]))
        seen = cast(room_of(drive), laser[None], scan.angles)[0]
        expected = np.where((seen < 0.06) | (seen > 10.0), np.inf, seen)
        assert_allclose(scan.ranges, expected, atol=1e-9)


def test_a_scanner_upside_down_sees_the_room_mirrored():
    def scans(mount):
        robot = ROBOT.model_copy(update={"lidar": ROBOT.lidar.model_copy(update={"mount": mount})})
        return make_recording(robot, duration=2.0, lidar_rate=5.0, beams=91, config=FAULTLESS).scans

    upright, flipped = scans(Mount(x=0.3932, z=0.233)), scans(Mount(x=0.3932, z=0.233, roll=np.pi))
    for a, b in zip(upright, flipped, strict=True):
        assert_allclose(b.ranges, a.ranges[::-1], atol=1e-9)


def test_range_noise_has_the_deviation_asked_for():
    noisy, exact = make(beams=541), make(config=SimulationConfig(range_deviation=0.0), beams=541)
    errors = np.concatenate([a.returns - b.returns for a, b in zip(noisy.scans, exact.scans, strict=True)])
    both = np.concatenate([(a.returns > 0) & (b.returns > 0) for a, b in zip(noisy.scans, exact.scans, strict=True)])
    assert errors[both].std() == pytest.approx(0.01, rel=0.03)


def test_the_gyro_integrates_to_the_truths_heading():
    recording = make(EXACT_ENCODER, FAULTLESS, duration=20.0)
    up = EXACT_ENCODER.imu.mount.matrix()[2, :3]  # the base's z axis in the sensor
    rates = np.array([up @ reading.angular_velocity for reading in recording.imu])
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * 0.01)])
    assert_allclose(heading, np.unwrap(recording.truth.poses[:, 2]), atol=1e-4)


def test_the_accelerometer_feels_gravity_and_the_second_derivative_of_where_it_sits():
    recording = make(EXACT_ENCODER, FAULTLESS)
    T = EXACT_ENCODER.imu.mount.matrix()
    poses, dt = recording.truth.poses, 0.01
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = T[:2, 3]
    place = poses[:, :2] + np.column_stack([c * x - s * y, s * x + c * y])
    a = (place[2:] - 2 * place[1:-1] + place[:-2]) / dt**2
    c, s = c[1:-1], s[1:-1]
    body = np.column_stack([c * a[:, 0] + s * a[:, 1], -s * a[:, 0] + c * a[:, 1], np.full(len(a), GRAVITY)])
    felt = np.array([reading.acceleration for reading in recording.imu[1:-1]])
    assert_allclose(felt @ T[:3, :3].T, body, atol=2e-3)


def test_gyro_bias_and_noise_are_those_of_the_description():
    first = np.array([make(seed=s, duration=1.0, lidar_rate=1.0).imu[0].angular_velocity for s in range(80)])
    assert first.std() == pytest.approx(np.hypot(0.01, 0.02), rel=0.15)


def test_the_same_seed_makes_the_same_recording_and_another_one_another():
    one, same, other = make(seed=3), make(seed=3), make(seed=4)
    for a, b in ((one.wheels[77].ticks, same.wheels[77].ticks), (one.scans[3].ranges, same.scans[3].ranges)):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(one.imu[50].acceleration, same.imu[50].acceleration)
    assert not np.allclose(one.truth.poses, other.truth.poses)


def test_the_drive_and_the_wheels_do_not_depend_on_the_scanner():
    few, many = make(beams=30), make(beams=60, lidar_rate=5.0)
    np.testing.assert_array_equal(few.truth.poses, many.truth.poses)
    np.testing.assert_array_equal(few.wheels[-1].ticks, many.wheels[-1].ticks)


def test_rates_mounts_and_the_field_of_view_are_as_asked():
    recording = make(beams=541, lidar_rate=5.0)
    counts = [len(recording.wheels), len(recording.scans), len(recording.imu), len(recording.truth)]
    assert counts == [501, 51, 1001, 1001]
    scan = recording.scans[0]
    assert_allclose(np.degrees(scan.angles[[0, -1]]), [-135.0, 135.0])
    assert_allclose(recording.mounts["front_laser"], ROBOT.lidar.mount.matrix())
    assert_allclose(recording.mounts["imu_link"], ROBOT.imu.mount.matrix())
    np.testing.assert_array_equal(recording.truth.poses[0], 0.0)


def test_sensors_that_the_description_lacks_are_left_out():
    recording = make(ROBOT.model_copy(update={"lidar": None, "imu": None}))
    assert (recording.scans, recording.imu, dict(recording.mounts)) == ((), (), {})


def test_what_cannot_be_simulated_is_refused_with_a_sentence():
    with pytest.raises(ConfigError, match="Only mecanum bases"):
        make(RobotDescription(name="cart", drive="differential"))
    for wrong in ({"duration": 0.5}, {"beams": 1}, {"lidar_rate": 0.0}, {"duration": float("nan")}):
        with pytest.raises(ConfigError, match="cannot be made"):
            make(**wrong)
