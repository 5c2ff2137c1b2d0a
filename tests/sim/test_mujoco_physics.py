"""The robot with physics: it drives as told on a good floor, slips on a bad one, and its sensors tell what is true."""

import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from longreach.control.hardware import Command, GripperCommand
from longreach.errors import ConfigError, ControlError
from longreach.io.robots import load_robot
from longreach.sim import mujoco_model, room
from longreach.sim.kinematic import GRAVITY
from longreach.sim.physics import PhysicsConfig, Simulation
from longreach.sim.record import make_recording, record
from longreach.sim.sensors import LidarTiming, SensorConfig, Timing
from longreach.sim.worlds import World

THING = load_robot("thing")
BASE = THING.description.base
EMPTY = World("empty", np.empty((0, 4)), np.empty(0), np.empty(0))
QUIET = PhysicsConfig(sensors=SensorConfig(lidar=LidarTiming(range_deviation=0.0, lost_beams=0.0)))


def drive(simulation, twist, duration, tick=0.02):
    """Drive at one twist; return all readings of each kind."""
    found = []
    for _ in range(round(duration / tick)):
        simulation.write(Command(simulation.stamp, base=np.array(twist, dtype=float)))
        simulation.advance(tick)
        found.append(simulation.read())
    return found


def all_of(readings, kind):
    return [one for r in readings for one in getattr(r, kind)]


def slip(floor):
    """Part of the way that its wheels roll which the base does not go, to and fro sideways as hard as it can."""
    simulation = Simulation(THING, EMPTY, floor=floor)
    readings = [r for side in (1.0, -1.0) for r in drive(simulation, [0.0, side, 0.0], 0.5)]
    rolled = np.diff([w.ticks for w in all_of(readings, "wheels")], axis=0) @ BASE.forward_matrix.T
    gone = np.diff([t.base for t in simulation.truths()[::2]], axis=0)[: len(rolled)]
    return np.abs(rolled - gone)[:, 1].sum() / np.abs(rolled)[:, 1].sum()


@pytest.fixture(scope="module")
def rest():
    """One second at rest in the laboratory: the simulation and its readings."""
    simulation = Simulation(THING, "laboratory", config=QUIET)
    found = []
    for _ in range(50):
        simulation.advance(0.02)
        found.append(simulation.read())
    return simulation, found


@pytest.mark.parametrize("twist", [(0.6, 0.0, 0.0), (0.0, 0.6, 0.0), (0.0, 0.0, 0.8), (-0.4, 0.3, 0.0)])
def test_on_a_good_floor_the_base_moves_within_3_percent_of_the_command(twist):
    simulation = Simulation(THING, EMPTY)
    drive(simulation, twist, 2.0)
    told = np.array(twist)
    real = np.mean([t.twist for t in simulation.truths() if t.stamp > 1.0], axis=0)
    assert np.linalg.norm(real - told) < 0.03 * np.linalg.norm(told)


def test_slip_grows_as_friction_falls():
    good, wet, slippery = (slip(floor) for floor in ("good", "wet", "slippery"))
    assert good < 0.05
    assert wet > 2.0 * good
    assert slippery > 1.3 * wet


@pytest.mark.parametrize("floor", ["good", "wet"])
def test_friction_gives_no_energy_a_base_that_is_driven_hard_does_not_outrun_its_wheels(floor):
    simulation = Simulation(THING, EMPTY, floor=floor)
    readings = drive(simulation, [1.0, 0.0, 0.0], 0.3)
    rolled = np.diff([w.ticks for w in all_of(readings, "wheels")], axis=0) @ BASE.forward_matrix.T / 0.02
    gone = np.diff([t.base for t in simulation.truths()[::2]], axis=0)[: len(rolled)] / 0.02
    assert np.all(gone[:, 0] < rolled[:, 0] + 0.01)


def test_at_rest_nothing_moves_and_the_imu_feels_gravity(rest):
    simulation, readings = rest
    truth = simulation.truth()
    assert_allclose(truth.base, 0.0, atol=1e-4)
    assert_allclose(truth.q[3:], THING.home[3:], atol=1e-5)
    felt = np.mean([r.acceleration for r in all_of(readings, "imu")], axis=0)
    noise = THING.description.imu.acceleration_deviation
    assert_allclose(felt, [0.0, 0.0, GRAVITY], atol=4 * noise / 10)
    assert_allclose(np.mean([w.force for w in all_of(readings, "wrenches")], axis=0), 0.0, atol=0.1)
    assert_allclose(np.mean([w.torque for w in all_of(readings, "wrenches")], axis=0), 0.0, atol=0.01)


def test_rates_are_those_asked_for_and_stamps_are_even(rest):
    _, readings = rest
    for kind, rate in (("wheels", 50), ("scans", 40), ("imu", 100), ("joints", 125), ("wrenches", 100)):
        stamps = np.array([one.stamp for one in all_of(readings, kind)])
        assert len(stamps) == pytest.approx(rate, abs=2), kind
        assert_allclose(np.diff(stamps), 1 / rate, atol=1e-9)


def test_a_scan_at_rest_is_that_of_the_known_room(rest):
    simulation, readings = rest
    scan = all_of(readings, "scans")[-1]
    x, y, heading = simulation.truth().base
    laser = np.array([[x + 0.3932, y, heading]])
    seen = room.cast(room.polygonal_room(), laser, scan.angles)[0]
    # A millimetre: the base's rest is not perfect, and a beam may graze a corner.
    assert np.quantile(np.abs(scan.ranges - seen)[np.isfinite(scan.ranges)], 0.99) < 1e-3
    assert np.isfinite(scan.ranges).mean() > 0.95


def test_readings_arrive_no_earlier_than_their_latency():
    late = SensorConfig(wheels=Timing(rate=50.0, latency=0.1), imu=Timing(rate=100.0, latency=0.0, dropout=0.5))
    simulation = Simulation(THING, EMPTY, config=PhysicsConfig(sensors=late))
    readings = drive(simulation, [0.0, 0.0, 0.0], 0.6, tick=0.01)
    assert all(r.stamp - w.stamp >= 0.1 - 1e-9 for r in readings for w in r.wheels)
    assert len(all_of(readings, "wheels")) == 26
    assert 15 < len(all_of(readings, "imu")) < 45


def test_the_same_seed_gives_the_same_bytes_and_another_one_other_noise_on_the_same_truth():
    def run(seed):
        simulation = Simulation(THING, "office", seed=seed)
        readings = drive(simulation, [0.3, -0.2, 0.4], 0.3)
        scans = np.array([s.ranges for s in all_of(readings, "scans")])
        joints = np.array([j.position for j in all_of(readings, "joints")])
        return scans, joints, np.array([t.base for t in simulation.truths()])

    one, same, other = run(3), run(3), run(4)
    for a, b in zip(one, same, strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(one[2], other[2])
    assert not np.array_equal(one[0], other[0])


def test_the_steps_taken_at_once_change_nothing():
    def end(tick):
        simulation = Simulation(THING, EMPTY)
        simulation.write(Command(0.0, base=np.array([0.5, 0.2, 0.1]), arm=np.full(6, 0.1)))
        for _ in range(round(0.2 / tick)):
            simulation.advance(tick)
        return simulation.truth().q

    np.testing.assert_allclose(end(0.2), end(0.004), atol=1e-9)


def test_the_arm_follows_speeds_and_angles_closely():
    simulation = Simulation(THING, EMPTY)
    for _ in range(50):
        simulation.write(Command(simulation.stamp, arm=np.array([0.3, 0.0, -0.2, 0.0, 0.1, 0.5])))
        simulation.advance(0.008)
    v = np.array([0.3, 0.0, -0.2, 0.0, 0.1, 0.5])
    assert_allclose(simulation.truth().q[3:] - THING.home[3:], v * (0.4 - 0.5 * np.abs(v) / 10), atol=2e-3)
    wanted = simulation.truth().q[3:]
    for _ in range(50):
        wanted = wanted + 0.002
        simulation.write(Command(simulation.stamp, arm=wanted, arm_mode="position"))
        simulation.advance(0.008)
    assert_allclose(simulation.truth().q[3:], wanted, atol=2e-3)


def test_torques_stay_within_the_joints_limits():
    simulation = Simulation(THING, EMPTY)
    efforts = []
    for i in range(40):
        jump = THING.home[3:] + (0.8 if i % 2 else -0.8)
        simulation.write(Command(simulation.stamp, arm=jump, arm_mode="position"))
        simulation.advance(0.008)
        efforts += [j.effort[:6] for j in simulation.read().joints]
    most = np.abs(efforts).max(axis=0)
    assert np.all(most <= THING.limits.effort[3:] + 1e-6)
    assert most.max() > 50.0


def test_the_tools_truth_is_that_of_the_joints_but_for_the_tilt_of_the_base():
    simulation = Simulation(THING, EMPTY)
    drive(simulation, [0.3, 0.3, 0.3], 0.6)
    truth = simulation.truth()
    T = THING.forward(truth.q)
    assert_allclose(truth.tool[:3, 3], T[:3, 3], atol=2e-3)
    assert_allclose(truth.tool[:3, :3], T[:3, :3], atol=2e-3)
    last = simulation.truths()[-1]
    assert_allclose(last.tool[:3, 3], THING.forward(last.q)[:3, 3], atol=2e-3)


def test_without_a_command_the_robot_comes_to_rest_after_the_timeout():
    simulation = Simulation(THING, EMPTY)
    simulation.write(Command(0.0, base=np.array([0.5, 0.0, 0.0]), arm=np.full(6, 0.2)))
    simulation.advance(0.25)
    assert simulation.truth().twist[0] > 0.4
    simulation.advance(0.75)
    before = simulation.truth()
    simulation.advance(0.2)
    assert_allclose(simulation.truth().q, before.q, atol=1e-3)


def test_a_stop_brakes_within_the_accelerations_and_stays():
    simulation = Simulation(THING, EMPTY)
    drive(simulation, [0.8, 0.0, 0.0], 0.6)
    simulation.stop("a test")
    drive(simulation, [0.8, 0.0, 0.0], 0.6)
    speeds = np.array([t.twist[0] for t in simulation.truths()])
    assert simulation.stopped == "a test"
    assert abs(speeds[-1]) < 0.01
    assert np.diff(speeds).min() > -2.5 * 0.01 * 1.5


def test_the_gripper_closes_and_says_so():
    simulation = Simulation(THING, EMPTY)
    simulation.write(Command(0.0, gripper=GripperCommand("position", 0.5)))
    simulation.advance(0.8)
    assert simulation.read().gripper.closed == pytest.approx(0.5, abs=0.02)
    simulation.write(Command(0.0, gripper=GripperCommand("force", 20.0)))
    simulation.advance(0.9)
    assert simulation.read().gripper.closed > 0.9


def test_an_edge_stops_the_hand_and_the_wrench_feels_where_from():
    edge = World("edge", np.array([[0.7, -1.0, 0.7, -0.2]]), np.full(1, 0.9), np.full(1, 1.12))  # where the hand passes
    simulation = Simulation(THING, edge)
    forces = []
    for _ in range(70):
        simulation.write(Command(simulation.stamp, base=np.array([0.3, 0.0, 0.0])))
        simulation.advance(0.02)
        R = simulation.truth().tool[:3, :3]
        forces += [R @ w.force for w in simulation.read().wrenches]
    assert simulation.truth().base[0] < 0.35
    assert np.min(forces, axis=0)[0] < -20.0


def test_what_runs_into_something_is_named_and_what_stands_on_the_floor_is_no_hit():
    wall = World("wall", np.array([[0.7, -1.0, 0.7, 1.0]]), np.zeros(1), np.full(1, 0.5))  # below the arm
    simulation = Simulation(THING, wall)
    drive(simulation, [0.4, 0.0, 0.0], 0.3)
    assert simulation.hit == ""
    drive(simulation, [0.4, 0.0, 0.0], 0.7)
    first = simulation.hit
    assert first.endswith(" s after the start.")
    assert first.split()[0] in THING.urdf.links
    drive(simulation, [-0.4, 0.0, 0.0], 0.3)
    assert simulation.hit == first


def test_commands_that_cannot_be_taken_are_refused():
    simulation = Simulation(THING, EMPTY)
    with pytest.raises(ControlError, match="base takes 3 finite numbers"):
        simulation.write(Command(0.0, base=np.array([0.0, np.nan, 0.0])))
    with pytest.raises(ControlError, match="arm takes 6 finite numbers"):
        simulation.write(Command(0.0, arm=np.zeros(5)))
    for wrong in (-1.0, float("inf"), float("nan")):
        with pytest.raises(ConfigError, match="Time can pass by 0 s or more"):
            simulation.advance(wrong)


def test_robots_without_wheels_of_this_kind_have_no_physics():
    with pytest.raises(ConfigError, match="Only robots of a URDF on mecanum wheels"):
        Simulation(load_robot("panda_cart"), EMPTY)


def test_without_mujoco_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    mujoco_model.engine.cache_clear()
    with pytest.raises(ConfigError, match=r'pip install "longreach\[sim\]"'):
        Simulation(THING, EMPTY)
    mujoco_model.engine.cache_clear()


def test_mujoco_is_loaded_only_when_a_simulation_is_made():
    code = "import sys, longreach.sim.kinematic, longreach.sim.record; print('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


def test_a_camera_gives_a_picture_or_a_sentence(rest):
    simulation, _ = rest
    with pytest.raises(ConfigError, match="There is no camera 'eye'; there are overview"):
        simulation.image("eye")
    try:
        picture = simulation.image("overview", 64, 48)
    except ConfigError as error:
        assert "EGL" in str(error)  # noqa: PT017
        pytest.skip("nothing to draw with here")
    assert picture.shape == (48, 64, 3)
    assert picture.std() > 5


def test_a_recorded_profile_holds_what_was_sensed_and_what_was_true():
    simulation = Simulation(THING, EMPTY)
    recording = record(simulation, lambda t: np.array([0.4 * np.sin(3 * t), 0.0, 0.3]), 1.0)
    kinds = ("wheels", "scans", "imu", "joints", "wrenches")
    counts = [len(getattr(recording, kind)) for kind in kinds]
    assert counts == pytest.approx([54, 43, 109, 137, 109], abs=2)
    steps = np.diff([w.ticks for w in recording.wheels], axis=0) @ BASE.forward_matrix.T
    assert steps[:, 2].sum() == pytest.approx(recording.truth.poses[-1, 2], rel=0.03)
    assert set(recording.mounts) == {"front_laser", "imu_link"}


def test_a_made_recording_starts_at_the_origin_and_is_the_same_for_the_same_seed():
    one, same = (make_recording(THING, seed=5, duration=1.0) for _ in range(2))
    assert_allclose(one.truth.poses[0], 0.0, atol=1e-6)
    np.testing.assert_array_equal(one.truth.poses, same.truth.poses)
    np.testing.assert_array_equal(one.scans[-1].ranges, same.scans[-1].ranges)
    with pytest.raises(ConfigError, match="at least 1 s"):
        make_recording(THING, duration=0.5)
