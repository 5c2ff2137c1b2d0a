"""Worlds for mapping: gaps in walls, copies, ways, places that look alike; and what the shipped ones hold."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from longreach.errors import ConfigError
from longreach.geometry import se2
from longreach.io.config import read_yaml, validated
from longreach.io.robots import load_robot
from longreach.sim import room
from longreach.sim.sensors import LidarTiming, Scanner
from longreach.sim.worlds import WorldDescription, load_world

LIDAR = load_robot("thing").description.lidar
REACH, HEIGHT = LIDAR.range_max, LIDAR.mount.z
NOISELESS = LidarTiming(range_deviation=0.0, lost_beams=0.0)


def described(name):
    import longreach.sim.worlds as worlds

    path = worlds.files("longreach.sim").joinpath("worlds").joinpath(f"{name}.yaml")
    return validated(WorldDescription, read_yaml(path), name)


def seen(world, pose):
    scanner = Scanner.of(LIDAR, NOISELESS, world.at_height(HEIGHT))
    return scanner.read(0.0, 0.0, 1e-3, np.tile(pose, (64, 1)), np.random.default_rng(0)).ranges


def world_of(**values):
    return validated(WorldDescription, {"name": "mine", **values}, "mine").world()


def crosses_no_wall(world, a, b):
    along = b - a
    angle = np.arctan2(along[1], along[0])
    return room.cast(world.segments, np.array([[*a, angle]]), np.zeros(1))[0, 0] > np.hypot(*along)


def test_a_gap_leaves_its_width_free_and_thickness_two_sides():
    gap = {"x": 2.0, "y": 1.0, "width": 0.9}
    wall = {"corners": [[0.0, 1.0], [5.0, 1.0]], "gaps": [gap], "thickness": 0.2}
    world = world_of(walls=[wall])
    ranges = room.cast(world.segments, np.array([[x, 0.0, np.pi / 2] for x in (1.54, 1.56, 2.44, 2.46)]), np.zeros(1))
    assert_allclose(ranges[:, 0], [0.9, np.inf, np.inf, 0.9])
    assert_allclose(world.solids[:, 4], 0.1)


def test_a_gap_beside_its_wall_is_refused():
    with pytest.raises(ConfigError, match=r"gap at 2, 1.5 does not lie within one straight piece"):
        world_of(walls=[{"corners": [[0.0, 1.0], [5.0, 1.0]], "gaps": [{"x": 2.0, "y": 1.5, "width": 1.0}]}])


def test_a_way_past_no_station_is_refused():
    with pytest.raises(ConfigError, match="ways pass b, which stations do not have"):
        world_of(stations={"a": [0, 0, 0]}, ways=[["a", "b"]])


def test_copies_stand_as_they_are_given_at_each_place():
    box = {"x": 1.0, "y": 0.0, "length": 0.4, "width": 0.2}
    copied = world_of(copies=[{"at": [[5.0, 0.0, np.pi / 2], [0.0, 3.0, 0.3]], "boxes": [box]}])
    moved = se2.compose(np.array([[5.0, 0.0, np.pi / 2], [0.0, 3.0, 0.3]]), np.array([1.0, 0.0, 0.0]))
    alone = world_of(boxes=[box | {"x": x, "y": y, "yaw": yaw} for x, y, yaw in moved.tolist()])
    assert_allclose(copied.segments, alone.segments, atol=1e-12)
    assert_allclose(copied.solids, alone.solids, atol=1e-12)


def test_the_building_has_rooms_that_are_entered_by_gaps_of_90_to_120_cm():
    description, world = described("building"), load_world("building")
    assert_allclose(np.ptp(world.segments.reshape(-1, 2), axis=0), [60.3, 30.3])
    gaps = [gap for wall in description.walls for gap in wall.gaps]
    assert len(gaps) >= 19
    assert {gap.width for gap in gaps} <= {0.9, 1.0, 1.1, 1.2}
    rooms = {name.split("_")[0] for name in description.stations if name.endswith("_in")}
    assert len(rooms) >= 12
    stations = {name: np.array(place[:2]) for name, place in description.stations.items()}
    for gap in gaps:  # a way passes through the middle of each
        assert min(np.hypot(*(place - [gap.x, gap.y])) for place in stations.values()) < 1e-6


@pytest.mark.parametrize("name", ["building", "storehouse", "twins"])
def test_no_way_crosses_a_wall(name):
    world = load_world(name)
    for a, b in world.ways.pairs:
        assert crosses_no_wall(world, world.ways.points[a], world.ways.points[b])


def test_the_building_has_two_rings_of_corridors():
    description = described("building")
    corners = {name: np.array(description.stations[name][:2]) for name in ("sw", "sm", "se", "ne", "nm", "nw")}
    world = load_world("building")
    for ring in (("sw", "sm", "nm", "nw", "sw"), ("sm", "se", "ne", "nm", "sm")):
        for a, b in pairwise(ring):
            assert crosses_no_wall(world, corners[a], corners[b])


def test_rooms_of_the_building_look_different():
    description, world = described("building"), load_world("building")
    middles = [np.array([*place[:2], 0.0]) for name, place in description.stations.items() if name.endswith("_in")]
    views = [np.sort(np.minimum(seen(world, pose), REACH)) for pose in middles]
    apart = [np.mean(np.abs(a - b)) for i, a in enumerate(views) for b in views[:i]]
    assert min(apart) > 0.05


def test_twins_look_the_same_and_unique_places_have_none(rng):
    world = load_world("twins")
    found = 0
    for _ in range(60):
        pose = np.array([rng.uniform(0.0, 57.0), rng.uniform(-6.0, 6.0), rng.uniform(-3.0, 3.0)])
        twins = world.twin_poses(pose)
        here = seen(world, pose)
        if not np.isfinite(here).any() or here.min() < 0.3:
            continue  # in a wall
        for twin in twins:
            found += 1
            there = seen(world, twin)
            near = np.isfinite(here) & np.isfinite(there)
            same = np.abs(here[near] - there[near]) < 1e-4
            assert np.mean(np.isfinite(here) == np.isfinite(there)) > 0.999
            assert same.mean() > 0.995  # a beam along an edge may pass on either side
    assert found > 100
    for unique in ([1.5, 5.0, 0.0], [-5.0, 2.3, 0.0], [55.5, 5.9, 1.0], [4.5, -5.0, 0.0], [0.0, 0.0, 0.0]):
        assert len(world.twin_poses(np.array(unique))) == 0


def test_a_twins_twins_are_the_same_places():
    world = load_world("twins")
    pose = np.array([13.5, 4.5, 0.4])
    twins = world.twin_poses(pose)
    assert len(twins) == 12
    back = world.twin_poses(twins[3])
    assert np.linalg.norm(se2.difference(back, pose), axis=1).min() < 1e-9


@pytest.mark.parametrize("name", ["building", "storehouse", "twins"])
def test_a_sweep_sees_what_a_cast_at_every_wall_sees(name):
    world = load_world(name)
    walls = world.at_height(HEIGHT)
    scanner = Scanner.of(LIDAR, NOISELESS, walls)
    for point in world.ways.points[::9]:
        pose = np.array([*point, 0.7 * point[0]])
        ranges = seen(world, pose)
        laser = se2.compose(pose, scanner.mount)
        brute = room.cast(walls, laser[None], scanner.angles)[0]
        brute[(brute > REACH) | (brute < LIDAR.range_min)] = np.inf
        assert_allclose(ranges, brute, atol=1e-5)
