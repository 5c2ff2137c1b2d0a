"""Long drives: along the ways of a world, free of everything that stands there, within the limits, repeatable."""

from itertools import islice, pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from longreach.errors import ConfigError
from longreach.io.robots import load_robot
from longreach.robot.footprint import footprint_of
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.long_drive import endless_drive, long_drive, tucked
from longreach.sim.record import readings_along, record_motion
from longreach.sim.sensors import SensorConfig, Timing
from longreach.sim.worlds import load_world, shipped_worlds

ROBOT = load_robot("thing")
WITH_WAYS = [name for name in shipped_worlds() if load_world(name).ways]


def clearances(world, poses):
    """Distance [m] from the footprint's rectangle at each pose to the nearest segment, 0 where one crosses it."""
    x0, x1, y0, y1 = footprint_of(ROBOT).rectangle
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])

    def seen_from(points):
        off = points - poses[:, None, :2]
        return np.stack([c[:, None] * off[..., 0] + s[:, None] * off[..., 1],
                         c[:, None] * off[..., 1] - s[:, None] * off[..., 0]], axis=-1)  # fmt: skip

    nearest = np.full(len(poses), np.inf)
    for segment in world.segments:  # as points so close to each other that none is off by more than a millimetre
        ends = segment.reshape(2, 2)
        if np.all(np.abs(poses[:, :2] - ends.mean(0)).max(axis=1) > np.hypot(*np.diff(ends, axis=0)[0]) + 1.5):
            continue
        count = int(np.hypot(*np.diff(ends, axis=0)[0]) / 0.02) + 2
        points = seen_from(ends[0] + np.linspace(0, 1, count)[:, None] * (ends[1] - ends[0]))
        out = np.maximum(np.maximum([x0, y0] - points, points - [x1, y1]), 0.0)
        nearest = np.minimum(nearest, np.hypot(out[..., 0], out[..., 1]).min(axis=1))
    return nearest


@pytest.mark.parametrize("name", WITH_WAYS)
def test_a_drive_of_300_m_keeps_clear_and_within_the_limits(name):
    world, description = load_world(name), ROBOT.description
    drive = long_drive(world, 300.0, seed=1)
    speed = np.hypot(*drive.velocity[:, :2].T)
    assert 300.0 < speed.sum() / 50.0 < 345.0
    assert_allclose(drive.poses[0], 0.0, atol=1e-9)
    assert speed[[0, -1]] == pytest.approx(0.0, abs=0.02)
    assert speed.max() <= 1.0
    assert speed.mean() > 0.5
    assert np.all(np.abs(drive.velocity).max(axis=0) < description.velocity_limits)
    assert np.all(np.abs(drive.acceleration).max(axis=0) < description.acceleration_limits)
    assert clearances(world, drive.poses[::15]).min() > 0.025


@pytest.mark.parametrize("name", WITH_WAYS)
def test_a_drive_comes_back_to_places_long_after(name):
    poses = long_drive(load_world(name), 300.0, seed=2).poses[::25]
    apart = np.linalg.norm(poses[:, None, :2] - poses[:, :2], axis=-1)
    late = np.abs(np.subtract.outer(np.arange(len(poses)), np.arange(len(poses)))) > 120  # a minute
    assert np.mean((late & (apart < 0.5)).any(axis=1)) > 0.5


def test_the_same_seed_gives_the_same_drive_and_another_one_another():
    world = load_world("building")
    first, again, other = (long_drive(world, 60.0, seed=seed).poses for seed in (3, 3, 4))
    assert_array_equal(first, again)
    assert len(first) != len(other) or np.abs(first - other).max() > 1.0


def test_laps_do_not_pass_the_same_points():
    poses = long_drive(load_world("building"), 600.0, seed=0).poses[::5]
    here = np.abs(poses[:, :2] - [15.0, 0.0]).max(axis=1) < 1.0
    assert np.ptp(poses[here, 1]) > 0.05


def test_pieces_of_an_endless_drive_join_at_rest():
    pieces = list(islice(endless_drive(load_world("building"), 5, piece=40.0), 4))
    for piece, onward in pairwise(pieces):
        assert_allclose(piece.poses[-1], onward.poses[0], atol=1e-6)
        assert np.abs(piece.velocity[-1]).max() < 0.02


def test_what_cannot_be_driven_is_said():
    with pytest.raises(ConfigError, match=r"The world office has no ways to drive along; take building"):
        long_drive(load_world("office"))
    with pytest.raises(ConfigError, match="longer than 0 m"):
        long_drive(load_world("building"), -1.0)
    with pytest.raises(ConfigError, match="begins at the origin along x"):
        long_drive(load_world("building").moved(1.0, 0.0))


def test_a_recorded_drive_stays_on_its_path_and_free_of_contact():
    world = load_world("building")
    drive = long_drive(world, 40.0, seed=1)
    config = KinematicConfig(present=("wheels", "imu", "lidar"))
    recording = record_motion(KinematicRobot(ROBOT, world, seed=1, q=tucked(ROBOT), config=config), drive)
    truth = recording.truth
    stamps = np.arange(len(drive.poses)) / 50.0
    meant = np.column_stack([np.interp(truth.stamps, stamps, axis) for axis in drive.poses[:, :2].T])
    assert np.linalg.norm(truth.poses[:, :2] - meant, axis=1).max() < 0.04
    assert clearances(world, truth.poses[::20]).min() > 0.02
    assert len(recording.scans) == pytest.approx(40 * stamps[-1], rel=0.02)


def test_readings_along_a_drive_are_those_that_a_recording_has():
    world = load_world("building")
    pieces = list(islice(endless_drive(world, 2, piece=5.0), 2))
    sensors = SensorConfig(truth=Timing(rate=0.001))
    robot = KinematicRobot(ROBOT, world, seed=2, config=KinematicConfig(sensors=sensors))
    read = list(readings_along(robot, pieces))
    assert len(read) == sum(len(piece.poses) for piece in pieces)
    assert_allclose(read[-1][1].base[:2], pieces[-1].poses[-1, :2], atol=0.05)
    assert len(robot.truths()) == 1  # nothing grows
    again = record_motion(KinematicRobot(ROBOT, world, seed=2), pieces[0])
    wheels = [wheel for readings, _ in read for wheel in readings.wheels][: len(pieces[0].poses) - 5]
    for mine, theirs in zip(wheels, again.wheels, strict=False):
        assert_array_equal(mine.ticks, theirs.ticks)


def test_a_tucked_arm_stays_above_the_base():
    q = tucked(ROBOT)
    footprint = footprint_of(ROBOT)
    _, front, right, left = footprint.rectangle
    capsules = footprint.capsules(q[ROBOT.arm])
    for x, y in (capsules[:, :2].T, capsules[:, 2:4].T):
        assert np.all(np.abs(y) + capsules[:, 4] < left + 0.02)
        assert np.all(x + capsules[:, 4] < front + 0.02)
    assert right == -left
