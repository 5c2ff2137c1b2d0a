"""The base minds what the laser sees: it stops in time, goes where it may, and remembers what is behind it."""

import numpy as np
import pytest

import longreach as lr
from longreach.configuration import ConfigurationTrajectory
from longreach.control import obstacles
from longreach.control.obstacles import limited, met_by
from longreach.geometry import se2
from longreach.measurement import LaserScan

_BRAKES = np.array([2.5, 2.5, 1.0])
_FRONT = 0.48  # of the base [m]


@pytest.fixture(scope="module")
def thing():
    return lr.load_robot("thing")


def _scan(thing, points, stamp=0.0, pose=(0.0, 0.0, 0.0)):
    """A sweep that sees single points (n, 2) [m] from where the base is, each by three beams, and nothing else."""
    lidar = thing.description.lidar
    angles = lidar.angle_min + lidar.angle_increment * np.arange(1081)
    laser = se2.compose(np.array(pose), np.array([lidar.mount.x, lidar.mount.y, 0.0]))
    ranges = np.zeros(1081)
    for x, y in se2.transform(se2.inverse(laser), np.atleast_2d(points)):
        beam = round((np.arctan2(y, x) - lidar.angle_min) / lidar.angle_increment)
        if 1 <= beam < 1080:
            ranges[beam - 1 : beam + 2] = np.hypot(x, y)
    return LaserScan(stamp, ranges, angles[0], lidar.angle_increment, 0.06, 10.0)


def _seen(thing, points, pose=(0.0, 0.0, 0.0)):
    state = obstacles.init(thing, thing.home[thing.arm])
    return obstacles.step(state, (_scan(thing, points, 0.0, pose),), None, np.array(pose), np.zeros(3), 0.0)


def _folded(thing):
    """Arm joints for which the whole arm stays above the base."""
    return np.array([0.0, -1.2, 2.5, -2.9, -1.57, 0.0])


@pytest.mark.parametrize("speed", [0.2, 0.5, 0.8, 1.1])
@pytest.mark.parametrize("gap", [0.1, 0.2, 0.35, 0.6])
def test_what_is_left_of_the_speed_can_be_braked_from_before_the_obstacle(thing, speed, gap):
    state = _seen(thing, [[1.2 + gap, 0.35]])
    reach = max(_FRONT, max(c[[0, 2]].max() + c[4] for c in state.capsules if abs(c[1]) < 0.5))
    state = _seen(thing, [[reach + gap, 0.0]])
    part, nearest = limited(state, np.array([speed, 0.0, 0.0]), _BRAKES)
    v = part * speed
    assert 0.1 * v + v * v / (2 * 0.8 * 2.5) < gap - 0.02
    if part < 1.0:
        assert nearest is not None
        assert nearest[0] == pytest.approx(reach + gap, abs=0.02)
        faster = min(speed, v + 0.1)
        assert 0.1 * faster + faster**2 / (2 * 0.8 * 2.5) > gap - 0.1  # and not much is given away


def test_it_goes_away_from_what_it_is_close_to_and_along_it_but_not_closer(thing):
    state = _seen(thing, [[-0.1, y] for y in (0.42, 0.425)] + [[x, 0.42] for x in np.linspace(0.0, 0.47, 40)])
    for twist, goes in (([0.0, -0.5, 0.0], True), ([0.5, 0.0, 0.0], True), ([0.0, 0.5, 0.0], False)):
        part, _ = limited(state, np.array(twist), _BRAKES)
        assert (part == 1.0) == goes, twist
        assert goes or part < 0.1


def test_a_turn_minds_what_the_corners_would_meet(thing):
    state = _seen(thing, [[0.55, 0.28]])
    turning, _ = limited(state, np.array([0.0, 0.0, -1.0]), _BRAKES)
    other, _ = limited(_seen(thing, [[1.5, 1.5]]), np.array([0.0, 0.0, -1.0]), _BRAKES)
    assert turning < 0.8
    assert other == 1.0


def test_what_lies_behind_is_remembered_until_the_laser_sees_through_its_place(thing):
    box = np.array([[0.75, 0.3], [0.75, 0.35], [0.75, 0.25]])
    state = _seen(thing, box)
    turned = np.array([0.0, 0.0, np.pi])
    nothing = LaserScan(0.1, np.full(1081, 9.0), -2.356, 0.25 * np.pi / 180, 0.06, 10.0)
    behind = obstacles.step(state, (nothing,), None, turned, np.zeros(3), 0.1)
    part, nearest = limited(behind, np.array([-1.0, 0.0, 0.0]), _BRAKES)
    assert part < 1.0
    assert nearest[0] == pytest.approx(-0.75, abs=0.05)
    again = obstacles.step(behind, (nothing,), None, np.zeros(3), np.zeros(3), 0.2)
    assert limited(again, np.array([1.0, 0.0, 0.0]), _BRAKES)[0] == 1.0  # it has been taken away


def test_the_robots_own_parts_are_no_obstacles(thing):
    state = _seen(thing, [[0.45, 0.1], [0.42, -0.2]])  # within the base
    assert limited(state, np.array([1.0, 0.0, 0.0]), _BRAKES)[0] == 1.0


def test_a_laser_upside_down_sees_the_same(thing):
    lidar = thing.description.lidar
    mount = lidar.mount.model_copy(update={"roll": np.pi})
    description = thing.description.model_copy(update={"lidar": lidar.model_copy(update={"mount": mount})})
    turned = type(thing)(description, thing.chain, thing.urdf)
    points = [[1.8, 0.6], [1.5, -0.4]]
    upright = _scan(thing, points)
    hanging = LaserScan(0.0, upright.ranges[::-1].copy(), upright.angle_min, upright.angle_increment, 0.06, 10.0)
    states = [
        obstacles.step(obstacles.init(r, None), (s,), None, np.zeros(3), np.zeros(3), 0.0)
        for r, s in ((thing, upright), (turned, hanging))
    ]
    found = [np.array(sorted(s.points[: s.count].tolist())) for s in states]
    np.testing.assert_allclose(found[1], found[0], atol=0.02)


def test_a_plan_through_something_seen_is_refused_by_name_of_its_place_and_time(thing):
    state = _seen(thing, [[2.5, 0.0], [2.5, 0.1]])
    goal = thing.home + np.array([3.0, 0, 0, 0, 0, 0, 0, 0, 0])
    plan = ConfigurationTrajectory(np.array([0.0, 10.0]), np.stack([thing.home, goal]))  # its two ends alone
    assert "seen at (2.50, " in met_by(state, plan)
    past = ConfigurationTrajectory(plan.stamps, plan.q + np.array([0, 1.5, 0, 0, 0, 0, 0, 0, 0]))
    assert met_by(state, past) == ""


def test_no_laser_or_no_base_minds_nothing(thing):
    bare = type(thing)(thing.description.model_copy(update={"lidar": None}), thing.chain, thing.urdf)
    assert obstacles.init(bare, None) is None
    assert obstacles.init(lr.load_robot("ur10"), None) is None


def test_a_clock_that_gives_no_number_changes_nothing(thing):
    state = _seen(thing, [[1.5, 0.0]])
    after = obstacles.step(state, (_scan(thing, [[3.0, 0.0]]),), None, np.zeros(3), np.ones(3), np.nan)
    np.testing.assert_array_equal(after.points[: after.count], state.points[: state.count])
