"""Simulated sensors by themselves: schedules, losses, and a sweep against plain ray casting."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from longreach.robot.description import Encoder, ImuSensor, Lidar, Mount
from longreach.sim import room
from longreach.sim.sensors import Gyro, LidarTiming, Line, Scanner, Timing, WrenchTiming, read_wheels, read_wrench

EXACT = LidarTiming(range_deviation=0.0, lost_beams=0.0)
LIDAR = Lidar(mount=Mount(x=0.39, y=0.05, z=0.2, yaw=0.3), range_max=30.0)


def test_a_reading_arrives_after_its_latency_and_not_before(rng):
    line = Line(Timing(rate=100.0, latency=0.02), rng)
    line.send("first", 0.01)
    assert line.take(0.0299) == ()
    assert line.take(0.03) == ("first",)
    assert line.take(1.0) == ()


def test_jitter_delays_readings_but_none_overtakes_another(rng):
    line = Line(Timing(rate=100.0, latency=0.01, jitter=0.05), rng)
    for i in range(200):
        line.send(i, 0.01 * i)
    arrivals = np.array([arrival for arrival, _ in line.waiting])
    late = arrivals - 0.01 * np.arange(200)
    assert np.all(np.diff(arrivals) >= 0)
    assert late.min() >= 0.01
    assert 0.05 < late.max() < 0.1
    assert line.take(10.0) == tuple(range(200))


def test_dropouts_lose_the_part_asked_for(rng):
    line = Line(Timing(rate=100.0, dropout=0.3), rng)
    for i in range(2000):
        line.send(i, 0.01 * i)
    assert len(line.take(100.0)) == pytest.approx(1400, abs=80)


@pytest.mark.parametrize("heading", [0.0, 2.0, -3.1, 7.0])
def test_a_sweep_at_rest_is_what_plain_ray_casting_sees(heading, rng):
    walls = room.polygonal_room()
    scanner = Scanner.of(LIDAR, EXACT, walls)
    pose = np.array([0.7, -0.4, heading])
    scan = scanner.read(0.01, 0.0, 0.001, np.tile(pose, (40, 1)), rng)
    c, s = np.cos(heading), np.sin(heading)
    laser = np.array([pose[0] + c * 0.39 - s * 0.05, pose[1] + s * 0.39 + c * 0.05, heading + 0.3])
    assert_allclose(scan.ranges, room.cast(walls, laser[None], scan.angles)[0], atol=2e-5)  # 32-bit angles
    assert len(scan.ranges) == 1081


def test_each_beam_is_cast_from_where_the_laser_is_at_its_own_time(rng):
    walls = room.polygonal_room()
    scanner = Scanner.of(LIDAR, EXACT, walls)
    times = 0.001 * np.arange(40)
    bases = np.column_stack([2.0 * times, -1.5 * times, 3.0 + 6.0 * times])
    scan = scanner.read(0.012, 0.0, 0.001, bases, rng)
    assert scan.time_increment == pytest.approx(0.25 / 360 / 40)
    for b in (0, 100, 540, 777, 1080):
        t = 0.012 + b * scan.time_increment
        x, y, heading = 2.0 * t, -1.5 * t, 3.0 + 6.0 * t
        c, s = np.cos(heading), np.sin(heading)
        laser = np.array([[x + c * 0.39 - s * 0.05, y + s * 0.39 + c * 0.05, heading + 0.3]])
        assert scan.ranges[b] == pytest.approx(room.cast(walls, laser, scan.angles[b : b + 1])[0, 0], abs=1e-5)


def test_a_sweep_close_to_walls_and_among_many_of_them_misses_none(rng):
    ends = rng.uniform(-3.0, 3.0, (300, 2))
    walls = np.hstack([ends, ends + rng.uniform(-0.4, 0.4, (300, 2))])
    scanner = Scanner.of(Lidar(), EXACT, walls)
    for pose in rng.uniform(-3.0, 3.0, (20, 3)):
        scan = scanner.read(0.0, 0.0, 0.001, np.tile(pose, (30, 1)), rng)
        assert_allclose(scan.ranges, room.cast(walls, pose[None], scan.angles)[0], atol=2e-5)  # 32-bit angles


def test_an_empty_world_gives_no_returns(rng):
    scan = Scanner.of(Lidar(), EXACT, np.empty((0, 4))).read(0.0, 0.0, 0.001, np.zeros((30, 3)), rng)
    assert not scan.returns.any()


def test_range_noise_and_lost_beams_are_as_asked(rng):
    walls, poses = room.polygonal_room(), np.zeros((30, 3))
    exact = Scanner.of(Lidar(), EXACT, walls).read(0.0, 0.0, 0.001, poses, rng)
    noisy = LidarTiming(range_deviation=0.02, lost_beams=0.1)
    scan = Scanner.of(Lidar(), noisy, walls).read(0.0, 0.0, 0.001, poses, rng)
    there = np.isfinite(scan.ranges)
    assert (scan.ranges - exact.ranges)[there].std() == pytest.approx(0.02, rel=0.1)
    assert np.mean(~there) == pytest.approx(0.1, abs=0.03)


def test_encoders_round_down_to_whole_counts():
    angles, speeds = np.array([0.1, -0.1, 3.0, 0.0]), np.ones(4)
    encoder = Encoder(signal="angle", counts_per_revolution=100.0)
    step = 2 * np.pi / 100
    assert_allclose(read_wheels(1.0, angles, speeds, encoder).ticks, step * np.floor(angles / step))
    assert_allclose(read_wheels(1.0, angles, speeds, Encoder(signal="speed")).speeds, 1.0)
    assert_allclose(read_wheels(1.0, angles, speeds, Encoder()).ticks, angles)


def test_the_gyros_bias_walks_from_where_it_starts():
    sensor = ImuSensor(gyro_deviation=1e-12, gyro_bias_deviation=0.5, gyro_bias_walk=0.1, acceleration_deviation=1e-12)
    ends = []
    for seed in range(60):
        gyro = Gyro(sensor, 100.0, np.random.default_rng(seed))
        first = gyro.read(0.0, np.zeros(3), np.zeros(3)).angular_velocity
        for i in range(25):
            last = gyro.read(0.01 * (i + 1), np.zeros(3), np.zeros(3)).angular_velocity
        ends.append((first, last - first))
    first, walked = np.array(ends).transpose(1, 0, 2)
    assert first.std() == pytest.approx(0.5, rel=0.15)
    assert walked.std() == pytest.approx(0.05, rel=0.15)


def test_a_held_load_at_rest_is_no_wrench_of_the_surroundings(rng):
    quiet = WrenchTiming(force_deviation=0.0, torque_deviation=0.0)
    weight, centre = np.array([3.0, -2.0, 20.0]), np.array([0.01, 0.02, 0.06])
    held = np.concatenate([-weight, -np.cross(centre, weight)])
    wrench = read_wrench(0.0, held, weight, centre, quiet, rng)
    assert_allclose([*wrench.force, *wrench.torque], 0.0, atol=1e-12)
    pushed = read_wrench(0.0, held - [0, 0, 5, 0, 0, 0], weight, centre, quiet, rng)
    assert_allclose(pushed.force, [0.0, 0.0, 5.0], atol=1e-12)
