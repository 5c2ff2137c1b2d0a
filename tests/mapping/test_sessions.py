"""Sessions of a map: those of one place are joined, those of other places are not."""

import numpy as np
import pytest

from longreach.app.map import build_map
from longreach.geometry import se2
from longreach.io.robots import load_robot
from longreach.mapping import sessions
from longreach.mapping.keyframes import odometry_edges
from longreach.mapping.map_file import Map, load_map, save_map
from longreach.sim.kinematic import make_recording
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.long_drive import long_drive
from longreach.sim.record import record_motion
from longreach.sim.sensors import LidarTiming, SensorConfig
from longreach.sim.worlds import load_world

pytestmark = pytest.mark.usefixtures("unchecked")
THING = load_robot("thing")


def drive(world, length, seed):
    """A drive through a world, its wheels' scale wrong by 2 %."""
    config = KinematicConfig(
        sensors=SensorConfig(lidar=LidarTiming(rate=10.0)), present=("wheels", "lidar"), slip=(0.02, 0.02, 0.02)
    )
    robot = KinematicRobot(THING, load_world(world), seed=seed, config=config)
    return record_motion(robot, long_drive(load_world(world), length, seed)).replace(name=f"{world}-{seed}")


def between(recording, first, last, name):
    """What was measured from one stamp to another."""

    def kept(readings):
        return tuple(reading for reading in readings if first <= reading.stamp < last)

    return recording.replace(name=name, wheels=kept(recording.wheels), scans=kept(recording.scans))


def halves(recording):
    stamps = [scan.stamp for scan in recording.scans]
    middle = stamps[len(stamps) // 2]
    return between(recording, stamps[0], middle, "first"), between(recording, middle, np.inf, "second")


@pytest.mark.long
def test_halves_of_a_drive_are_joined_to_within_centimetres_of_the_truth():
    parts = halves(drive("building", 130.0, 1))
    built = build_map(parts, THING)
    assert built.left_out == ()
    assert [session.name for session in built.sessions] == ["first", "second"]
    start = None
    for part, name in zip(parts, ("mapped", "mapped_2"), strict=True):
        path = built.trajectories[name]
        truth, _ = part.truth.at(path.clock)
        start = se2.compose(path.poses[0], se2.inverse(truth[0])) if start is None else start
        off = path.poses - se2.compose(np.broadcast_to(start, truth.shape), truth)
        assert np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1))) < 0.02, name


@pytest.mark.long
def test_a_session_of_another_building_is_left_out_and_the_map_stays():
    house, other = drive("building", 50.0, 1), drive("storehouse", 50.0, 2)
    alone, built = build_map(house, THING), build_map([house, other], THING)
    assert built.left_out == ("storehouse-2",)
    np.testing.assert_array_equal(built.graph.poses, alone.graph.poses)
    assert built.remarks[0].startswith("storehouse-2 is left out of the map: no 3 of its places, over 6 m of path, fit")
    assert "mapped_2" not in built.trajectories
    assert "fused_2" in built.trajectories


@pytest.fixture(scope="module")
def small():
    return build_map(make_recording(THING, seed=1, duration=6.0, lidar_rate=5.0, beams=361), THING)


def test_a_maps_keyframes_come_back_with_the_odometry_that_they_had(small, tmp_path):
    save_map(tmp_path / "map.lrmap", small)
    keyframes = sessions.keyframes_of(load_map(tmp_path / "map.lrmap"))
    edges = odometry_edges(keyframes)
    np.testing.assert_allclose(edges.z, small.graph.odometry.z, atol=1e-12)
    assert np.array_equal(edges.j, small.graph.odometry.j)
    assert np.all(np.diff([k.way for k in keyframes]) > 0)


def test_a_second_session_begins_far_along_the_way_and_nothing_joins_it_at_first(small):
    twice = Map(
        small.graph, small.weights, small.scans, small.twists, small.session, small.sessions
    )  # fmt: skip
    state = sessions.begin(twice, np.eye(4))
    assert (state.first, state.is_joined) == (len(small.scans), False)
    assert state.way > 1000.0


def test_a_map_that_was_built_is_a_map_and_says_what_became_of_each_closure(small):
    assert isinstance(small, Map)
    assert small.parts[0].first == 0
    assert {closure.status for closure in small.parts[0].closures} <= {"accepted", "refused", "waiting", "withdrawn"}
    assert small.metrics["map"]["keyframes"]["value"] == len(small.scans)
