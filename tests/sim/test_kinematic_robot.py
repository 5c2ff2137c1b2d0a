"""The robot without forces: it does as it is told but for a known slip, and its sensors tell what is true."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from longreach.control.hardware import Command, GripperCommand
from longreach.errors import ConfigError, ControlError
from longreach.geometry import se2
from longreach.io.bag import read_bag
from longreach.io.bag_writer import write_bag
from longreach.io.robots import load_robot
from longreach.sim import room
from longreach.sim.kinematic import GRAVITY
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.monte_carlo import drive_many
from longreach.sim.physics import Simulation
from longreach.sim.record import record, tool_truth
from longreach.sim.sensors import JointTiming, LidarTiming, SensorConfig, Timing

THING = load_robot("thing")
BASE = THING.description.base
LIMITS = THING.limits.acceleration[THING.arm]
EVEN = KinematicConfig(slip_deviation=(0.0, 0.0, 0.0))
EXACT = KinematicConfig(
    slip=(0.0, 0.0, 0.0),
    slip_deviation=(0.0, 0.0, 0.0),
    sensors=SensorConfig(
        joints=JointTiming(rate=125.0, position_deviation=0.0, velocity_deviation=0.0),
        lidar=LidarTiming(range_deviation=0.0, lost_beams=0.0),
    ),
    present=("wheels", "imu", "joints", "lidar"),
)
QUIET_IMU = {"gyro_deviation": 1e-12, "gyro_bias_deviation": 0, "gyro_bias_walk": 0, "acceleration_deviation": 1e-12}


def drive(robot, commands, tick=0.02):
    """Send a command a tick, with these parts; return all readings."""
    found = []
    for parts in commands:
        robot.write(Command(robot.stamp, **parts))
        robot.advance(tick)
        found.append(robot.read())
    return found


def all_of(readings, kind):
    return [one for r in readings for one in getattr(r, kind)]


def twists(*rows, count=50):
    return [{"base": np.array(row, dtype=float)} for row in rows for _ in range(count)]


@pytest.mark.parametrize(("twist", "lost"), [((0.6, 0, 0), 0.002), ((0, 0.6, 0), 0.018), ((0, 0, 0.8), 0.016)])
def test_each_axis_lacks_the_part_that_slips(twist, lost):
    robot = KinematicRobot(THING, config=EVEN)
    drive(robot, twists(twist))
    assert_allclose(robot.truth().twist, (1 - lost) * np.array(twist), atol=1e-12)


def test_the_wheels_turn_for_what_was_told_and_do_not_know_of_the_slip():
    robot = KinematicRobot(THING, config=EVEN)
    told = twists((0.5, -0.3, 0.4), (-0.5, 0.2, 0.3), (0.0, 0.0, 0.0))
    wheels = np.array([w.ticks for w in all_of(drive(robot, told), "wheels")])
    turned = (wheels[-1] - wheels[0]) @ BASE.forward_matrix.T
    speed, most, rolled = np.zeros(3), np.array(THING.description.acceleration_limits) * 1e-3, np.zeros(3)
    for command in told:
        for _ in range(20):
            speed += np.clip(command["base"] - speed, -most, most)
            rolled += speed * 1e-3
    assert_allclose(turned, rolled, atol=1e-3)
    assert_allclose((wheels @ BASE.residual_matrix.T), 0.0, atol=1e-3)  # an encoder's counts


def test_without_slip_the_wheels_integrate_to_the_truth():
    robot = KinematicRobot(THING, config=EXACT)
    readings = drive(robot, twists((0.8, 0.3, 0.5), (-0.2, 0.6, -0.7), (0.0, 0.0, 0.0)))
    pose = np.zeros(3)
    for step in np.diff([w.ticks for w in all_of(readings, "wheels")], axis=0) @ BASE.forward_matrix.T:
        pose = se2.retract(pose, step)
    assert_allclose(se2.difference(robot.truth().base, pose), 0.0, atol=2e-3)


def test_slip_wanders_as_far_as_was_asked_for():
    config = KinematicConfig(slip=(0, 0, 0), slip_deviation=(0.05, 0.1, 0.02), slip_time=0.2)
    robot = KinematicRobot(THING, config=config)
    drive(robot, twists((0.5, 0.5, 0.5), count=1000))
    found = np.array([t.twist for t in robot.truths() if t.stamp > 1.0]) / 0.5 - 1.0
    assert_allclose(found.mean(axis=0), 0.0, atol=0.03)
    assert_allclose(found.std(axis=0), config.slip_deviation, rtol=0.2)


def test_it_goes_where_the_one_with_physics_goes():
    """Two roads: with forces, and without."""
    t = 0.02 * np.arange(101)
    waves = np.sin(0.5 * np.pi * t)[:, None] * [0.4, 0.3, 0.3]
    told = [{"base": wave, "arm": np.full(6, 0.2)} for wave in waves]
    kinematic, physics = KinematicRobot(THING, config=EVEN), Simulation(THING)
    for robot in (kinematic, physics):
        drive(robot, told)
    one, other = kinematic.truth(), physics.truth()
    assert_allclose(one.base, other.base, atol=0.02)
    assert one.base[0] > 0.4
    assert_allclose(one.q[3:], other.q[3:], atol=2e-3)
    assert_allclose(one.tool[:3, 3], other.tool[:3, 3], atol=0.02)
    assert [t.stamp for t in physics.truths()] == pytest.approx([t.stamp for t in kinematic.truths()[:202]])


def test_how_time_is_cut_changes_nothing():
    found = []
    for cuts in ([1.0], [0.02] * 50, [0.001, 0.499, 0.5]):
        robot = KinematicRobot(THING, seed=3)
        robot.write(Command(0.0, base=np.array([0.3, 0.2, 0.1]), arm=np.full(6, 0.3)))
        for cut in cuts:
            robot.advance(cut)
        found.append((robot.truth(), robot.read(), robot.truths()))
    for truth, readings, truths in found[1:]:
        assert_array_equal(truth.tool, found[0][0].tool)
        assert len(truths) == len(found[0][2]) == 101
        for kind, name in (("wheels", "ticks"), ("imu", "acceleration"), ("joints", "velocity")):
            some, first = getattr(readings, kind), getattr(found[0][1], kind)
            assert [s.stamp for s in some] == [f.stamp for f in first]
            assert_array_equal([getattr(s, name) for s in some], [getattr(f, name) for f in first])


def test_another_seed_gives_other_noise():
    one, other = (KinematicRobot(THING, seed=seed) for seed in (1, 2))
    for robot in (one, other):
        robot.advance(0.1)
    assert np.all(one.read().imu[0].acceleration != other.read().imu[0].acceleration)


def test_sensors_read_at_their_rates():
    robot = KinematicRobot(THING, config=EXACT)
    robot.advance(1.0 + 0.03)
    readings = robot.read()
    assert_allclose([w.stamp for w in readings.wheels], 0.02 * np.arange(52), atol=1e-12)
    assert_allclose([m.stamp for m in readings.imu], 0.01 * np.arange(102) + 0.005, atol=1e-12)
    assert_allclose([j.stamp for j in readings.joints], 0.008 * np.arange(129), atol=1e-12)
    assert_allclose([s.stamp for s in readings.scans], 0.025 * np.arange(41), atol=1e-12)


def test_only_what_is_present_reads():
    robot = KinematicRobot(THING, config=KinematicConfig(present=("wheels",)))
    robot.advance(0.5)
    readings = robot.read()
    assert readings.wheels
    assert (readings.imu, readings.joints, readings.scans) == ((), (), ())


def test_a_scan_at_rest_is_that_of_the_room_and_one_in_a_turn_is_swept():
    robot = KinematicRobot(THING, config=EXACT)
    robot.advance(0.1)
    mount, scan = se2.from_se3(THING.description.lidar.mount.matrix()), robot.read().scans[0]
    seen = room.cast(room.polygonal_room(), mount[None], scan.angles)[0]
    near = seen < 10.0
    assert_allclose(scan.ranges[near], seen[near], atol=2e-5)
    scan = drive(robot, twists((0.3, 0.0, 1.0), count=75))[-1].scans[-1]
    poses = {round(t.stamp, 3): t for t in robot.truths()}
    t = poses[round(scan.stamp - 0.005, 3)] if round(scan.stamp, 2) != round(scan.stamp, 3) else poses[scan.stamp]
    for b in (0, 540, 1080):
        after = scan.stamp + b * scan.time_increment - t.stamp
        laser = se2.compose(se2.retract(t.base, t.twist * after), mount)
        seen = room.cast(room.polygonal_room(), laser[None], scan.angles[b : b + 1])[0, 0]
        assert scan.ranges[b] == pytest.approx(seen, abs=1e-3)


def test_the_imu_feels_the_turn_and_what_moves_the_point_where_it_sits():
    imu = THING.description.imu.model_copy(update=QUIET_IMU)
    quiet = load_robot("thing")
    object.__setattr__(quiet, "description", THING.description.model_copy(update={"imu": imu}))
    often = EXACT.sensors.model_copy(update={"truth": Timing(rate=1000.0)})
    robot = KinematicRobot(quiet, config=EXACT.model_copy(update={"sensors": often, "present": ("imu",)}))
    told = [{"base": np.array([0.4 * np.sin(0.05 * i), 0.2, 0.5 * np.sin(0.04 * i)])} for i in range(150)]
    readings, truths = all_of(drive(robot, told), "imu"), robot.truths()
    p = imu.mount.matrix()[:2, 3]
    poses = np.array([t.base for t in truths])
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    points = poses[:, :2] + np.stack([c * p[0] - s * p[1], s * p[0] + c * p[1]], axis=1)
    twist = np.array([t.twist for t in truths])
    v = np.stack([c * twist[:, 0] - s * twist[:, 1], s * twist[:, 0] + c * twist[:, 1]], axis=1)
    v += twist[:, 2:] * np.stack([-s * p[0] - c * p[1], c * p[0] - s * p[1]], axis=1)
    assert_allclose(np.diff(points, axis=0) / 0.001, v[1:], atol=2e-3)
    ends, middle = slice(0, 10 * len(readings) + 1, 10), poses[5 : 10 * len(readings) : 10, 2]
    felt, c, s = np.diff(v[ends], axis=0) / 0.01, np.cos(middle), np.sin(middle)
    felt = np.stack([c * felt[:, 0] + s * felt[:, 1], -s * felt[:, 0] + c * felt[:, 1]], axis=1)
    forces = np.array([m.acceleration for m in readings])
    assert_allclose(forces[:, :2], felt, atol=0.02)
    assert_allclose(forces[:, 2], GRAVITY, atol=1e-9)
    gyro = np.array([m.angular_velocity[2] for m in readings])
    assert_allclose(gyro, np.diff(poses[ends, 2]) / 0.01, atol=1e-6)
    assert np.ptp(forces[:, 0]) > 0.3


def test_the_arm_follows_speeds_and_angles_within_its_limits():
    robot = KinematicRobot(THING, config=EXACT)
    speeds = np.array([0.5, -0.3, 0.4, 0.2, -0.6, 0.7])
    drive(robot, [{"arm": speeds}] * 100, tick=0.008)
    truth = robot.truth()
    ramp = np.abs(speeds) / LIMITS
    assert_allclose(truth.q[3:], THING.home[3:] + speeds * (0.8 - 0.5 * ramp), atol=1e-3)
    wanted = truth.q[3:] + 0.01
    read = drive(robot, [{"arm": wanted, "arm_mode": "position"}] * 2, tick=0.008)[-1]
    assert_allclose(robot.truth().q[3:], wanted, atol=1e-12)
    assert_allclose(read.joints[-1].position[:6], wanted, atol=1e-9)
    drive(robot, [{"arm": np.full(6, 100.0)}] * 40, tick=0.2)
    assert np.all(robot.truth().q[3:] <= THING.upper[3:] + 1e-12)


def test_without_a_command_base_and_arm_come_to_rest_after_the_timeout():
    robot = KinematicRobot(THING, config=EVEN)
    drive(robot, [{"base": np.array([0.5, 0.0, 0.2]), "arm": np.full(6, 0.3)}] * 30)
    robot.advance(0.2)
    assert robot.truth().twist[0] > 0.4
    before = robot.truth()
    robot.advance(1.0)
    after = robot.truth()
    assert_array_equal(after.twist, 0.0)
    assert 0.01 < np.linalg.norm(after.base[:2] - before.base[:2]) < 0.2


def test_a_stop_brakes_within_the_accelerations_and_stays():
    robot = KinematicRobot(THING, config=EVEN)
    drive(robot, twists((1.0, 0.0, 0.0), count=30))
    robot.stop("enough")
    robot.stop("again")
    speeds = []
    for _ in range(100):
        robot.write(Command(robot.stamp, base=np.array([1.0, 0.0, 0.0]), arm=np.ones(6)))
        robot.advance(0.01)
        speeds.append(robot.truth().twist[0])
    assert np.all(np.diff(speeds) >= -0.0251)
    assert speeds[-1] == 0.0
    assert robot.stopped == "enough"


def test_the_gripper_closes_and_says_so():
    robot = KinematicRobot(THING)
    found = drive(robot, [{"gripper": GripperCommand("position", 0.6)}] * 40)
    assert found[10].gripper.velocity == pytest.approx(1.0, abs=0.02)
    assert found[-1].gripper.closed == pytest.approx(0.6, abs=1e-3)
    assert robot.capabilities.gripper


@pytest.mark.parametrize("parts", [{"base": [np.nan, 0, 0]}, {"arm": [0.0] * 5}, {"arm": [np.inf] * 6}])
def test_commands_that_cannot_be_taken_are_refused(parts):
    with pytest.raises(ControlError, match="finite numbers, but the command has"):
        KinematicRobot(THING).write(Command(0.0, **{k: np.array(v, dtype=float) for k, v in parts.items()}))


def test_a_differential_base_does_not_move_sideways():
    robot = KinematicRobot(load_robot("panda_cart"), config=EVEN)
    read = drive(robot, twists((0.4, 0.5, 0.0)))
    assert_allclose(robot.truth().base[1:], 0.0, atol=1e-12)
    assert robot.truth().base[0] > 0.3
    wheels = np.array([w.ticks for w in all_of(read, "wheels")])
    rolled = robot.robot.description.base.forward_matrix @ (wheels[-1] - wheels[0])
    assert rolled[0] == pytest.approx(robot.truth().base[0] / (1 - EVEN.slip[0]), abs=0.01)
    poses, _ = drive_many(robot.robot, np.full((2, 50, 3), [0.4, 0.5, 0.0]), config=EVEN)
    assert_allclose(poses[:, -1], np.tile(robot.truth().base, (2, 1)), atol=1e-12)


def test_a_robot_without_described_wheels_says_odometry_that_does_not_know_of_the_slip():
    exact, slipping = (KinematicRobot(load_robot("husky"), config=config) for config in (EXACT, EVEN))
    told = twists((0.5, 0.0, 0.6), (0.3, 0.0, -0.9), (0.0, 0.0, 0.0))
    for robot in (exact, slipping):
        odometry = all_of(drive(robot, told), "wheels")
        assert_allclose(se2.difference(exact.truth().base, odometry[-1].pose), 0.0, atol=1e-3)
        assert max(o.twist[0] for o in odometry) == pytest.approx(0.5)
    assert np.linalg.norm(se2.difference(exact.truth().base, slipping.truth().base)) > 3e-3


def test_a_bolted_arm_stays_where_it_is_and_has_no_wheels():
    robot = KinematicRobot(load_robot("ur10"), config=EXACT)
    readings = drive(robot, [{"arm": np.full(6, 0.2), "base": np.ones(3)}] * 50)
    assert all_of(readings, "wheels") == []
    assert_allclose(robot.truth().base, 0.0)
    assert_allclose(robot.truth().q, robot.robot.home + 0.2, atol=0.01)


def test_what_cannot_be_simulated_is_refused():
    with pytest.raises(ConfigError, match="Time can pass by 0 s or more"):
        KinematicRobot(THING).advance(-1.0)
    with pytest.raises(ConfigError, match="at least a millisecond"):
        drive_many(THING, np.zeros((1, 1, 3)), 0.0)


def test_many_drives_at_once_are_what_one_robot_does(rng):
    told = rng.uniform(-1, 1, (4, 30, 3))
    poses, wheels = drive_many(THING, told, config=EVEN)
    robot = KinematicRobot(THING, config=EVEN)
    readings = drive(robot, [{"base": twist} for twist in told[2]])
    assert_allclose(poses[2, :, :2], [t.base[:2] for t in robot.truths()[::2]], atol=1e-12)
    read = [w.ticks for w in all_of(readings, "wheels")]
    assert_allclose(wheels[2, : len(read)], read, atol=THING.description.encoder.resolution)


def test_many_drives_scatter_as_slip_says():
    told = np.tile([0.5, 0.0, 0.0], (400, 100, 1))
    config = KinematicConfig(slip=(0, 0, 0), slip_deviation=(0.05, 0, 0), slip_time=1e6)
    poses, _ = drive_many(THING, told, config=config)
    assert poses[:, -1, 0].std() == pytest.approx(0.05 * poses[:, -1, 0].mean(), rel=0.1)


def test_a_recorded_run_comes_back_from_its_bag_bit_for_bit(tmp_path):
    config = KinematicConfig(present=("wheels", "imu", "joints", "lidar"), sensors=SensorConfig(imu=Timing(rate=100.0)))
    robot = KinematicRobot(THING, config=config)
    made = record(robot, lambda t: np.array([0.4 * np.sin(t), 0.1, 0.3]), 1.0)
    tool = {"truth": tool_truth(robot.truths())}
    write_bag(tmp_path / "run.mcap", made, THING.description, estimate=made.truth, tool=tool)
    found = read_bag(tmp_path / "run.mcap", THING.description)
    assert found.remarks == ()
    for kind in ("wheels", "scans", "imu", "joints"):
        assert len(getattr(found, kind)) == len(getattr(made, kind)) > 10
        for a, b in zip(getattr(found, kind), getattr(made, kind), strict=True):
            for name, value in vars(b).items():
                assert_array_equal(getattr(a, name), value)
    assert_array_equal(found.truth.stamps, made.truth.stamps)
    assert_allclose(found.truth.poses, made.truth.poses, atol=1e-15)
