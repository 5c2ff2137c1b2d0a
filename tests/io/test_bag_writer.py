"""A recording written as a bag and read again is the same recording, in each of ROS's formats."""

import dataclasses
import math

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from longreach.configuration import ConfigurationTrajectory
from longreach.errors import RecordingError
from longreach.geometry import se3
from longreach.io.bag import read_bag
from longreach.io.bag_writer import new_bag, write_bag
from longreach.io.messages import imu
from longreach.measurement import (
    Imu,
    JointState,
    LaserScan,
    Odometry,
    PoseMeasurement,
    Recording,
    WheelSpeeds,
    WheelTicks,
    Wrench,
)
from longreach.reference import Reference
from longreach.robot.bases import MecanumBase
from longreach.robot.description import Encoder, RobotDescription, Topics
from longreach.trajectory import PoseTrajectory, monotone_clock

FORMATS = ["run.bag", "run.mcap", "run"]
SINCE_1970 = 1_649_348_542.220450401
TOPICS = Topics(truth="/truth", fixes="/fixes", joints="/arm")


def robot(signal="angle", topics=TOPICS):
    base = MecanumBase(wheel_radius=0.1, half_length=0.3, half_width=0.2)
    encoder = Encoder(signal=signal, counts_per_revolution=1000.0)
    return RobotDescription(name="r", base=base, encoder=encoder, topics=topics)


def recording(rng, start, wheels):
    stamps = [start + 0.02 * i for i in range(30)]
    arm = ("shoulder", "elbow")
    return Recording(
        name="run",
        wheels=tuple(wheels(s, rng.normal(size=4)) for s in stamps),
        scans=tuple(
            LaserScan(s + 0.004, rng.uniform(0, 9, 7), -1.5, 0.5, 0.25, 8.0, 0.001, "front") for s in stamps[::4]
        ),
        imu=tuple(Imu(s + 0.007, rng.normal(size=3), rng.normal(size=3), "imu_link") for s in stamps),
        fixes=tuple(PoseMeasurement(s + 0.001, rng.uniform(-3, 3, 3), np.diag([0.1, 0.2, math.inf])) for s in stamps),
        joints=tuple(JointState(s, arm, rng.normal(size=2), np.zeros(0), rng.normal(size=2)) for s in stamps),
        wrenches=tuple(Wrench(s + 0.002, rng.normal(size=3), rng.normal(size=3), "wrist") for s in stamps),
        truth=PoseTrajectory(np.array(stamps), rng.uniform(-3, 3, (30, 3))),
        mounts={"front": se3.exp(rng.normal(size=6)), "imu_link": se3.exp(rng.normal(size=6))},
    )


def assert_same(found, wanted):
    assert type(found) is type(wanted)
    for field in dataclasses.fields(wanted):
        a, b = getattr(found, field.name), getattr(wanted, field.name)
        if field.name == "stamp":
            assert a == pytest.approx(b, abs=1e-9, rel=1e-16)
        elif field.name == "source" or b is None or isinstance(b, str | tuple):
            assert a == b
        elif isinstance(wanted, LaserScan):
            np.testing.assert_array_equal(np.float32(a), np.float32(b))
        else:
            np.testing.assert_allclose(a, b, atol=1e-12)


def assert_same_recording(found, wanted):
    for sensor in ("wheels", "scans", "imu", "fixes", "joints", "wrenches"):
        a, b = getattr(found, sensor), getattr(wanted, sensor)
        assert len(a) == len(b) > 0
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    np.testing.assert_allclose(found.truth.stamps, wanted.truth.stamps, atol=1e-9, rtol=1e-16)
    np.testing.assert_allclose(found.truth.poses, wanted.truth.poses, atol=1e-12)
    assert found.mounts.keys() == wanted.mounts.keys()
    for frame, T in wanted.mounts.items():
        np.testing.assert_allclose(found.mounts[frame], T, atol=1e-12)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("start", [0.0, SINCE_1970])
def test_a_recording_written_and_read_again_is_the_same(tmp_path, rng, name, start):
    written = recording(rng, start, WheelTicks)
    write_bag(tmp_path / name, written, robot())
    found = read_bag(tmp_path / name, robot())
    assert_same_recording(found, written)
    assert (found.name, found.remarks, found.recorded_stamps) == ("run", (), {})
    assert [p.name for p in tmp_path.iterdir()] == [name]  # nothing else is left behind


def full_odometry(stamp, values):
    P = np.diag(np.square(values[:3])) + 0.01
    return Odometry(stamp, values[:3], values[1:], P, 2 * P)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize(
    ("wheels", "signal"),
    [
        (WheelTicks, "ticks"),
        (WheelSpeeds, "speed"),
        (full_odometry, "angle"),
        (lambda s, v: Odometry(s, pose=v[:3]), "angle"),
        (lambda s, v: Odometry(s, twist=v[:3]), "angle"),
    ],
    ids=["ticks", "speeds", "odometry", "poses", "twists"],
)
def test_wheels_of_every_kind_come_back(tmp_path, rng, name, wheels, signal):
    written = recording(rng, 3.0, wheels)
    write_bag(tmp_path / name, written, robot(signal))
    assert_same_recording(read_bag(tmp_path / name, robot(signal)), written)


@pytest.mark.parametrize("name", FORMATS)
def test_stamps_that_ran_backwards_come_back_with_their_repaired_clock(tmp_path, rng, name):
    recorded = np.array([5.0, 5.1, 5.2, 4.9, 5.0, 5.4, 5.5])
    clock = monotone_clock(recorded)
    written = Recording(
        name="run",
        wheels=tuple(WheelTicks(s, rng.normal(size=4)) for s in clock.tolist()),
        recorded_stamps={c: r for c, r in zip(clock.tolist(), recorded.tolist(), strict=True) if c != r},
        truth=PoseTrajectory(recorded, np.zeros((7, 3))),
    )
    write_bag(tmp_path / name, written, robot())
    found = read_bag(tmp_path / name, robot())
    stamps = np.array([w.stamp for w in found.wheels])
    np.testing.assert_allclose(stamps, clock, atol=1e-9)
    np.testing.assert_allclose(found.as_recorded(stamps), recorded, atol=1e-9)
    np.testing.assert_allclose(found.truth.stamps, recorded, atol=1e-9)
    assert len([remark for remark in found.remarks if "1 stamps of" in remark and "run backwards" in remark]) == 2


@pytest.mark.parametrize("name", FORMATS)
def test_a_truth_without_heading_comes_back_without(tmp_path, rng, name):
    truth = PoseTrajectory(np.arange(4.0), np.column_stack([rng.normal(size=(4, 2)), np.zeros(4)]), has_heading=False)
    wheels = tuple(WheelTicks(s, rng.normal(size=4)) for s in (0.0, 1.0))
    write_bag(tmp_path / name, Recording(name="run", wheels=wheels, truth=truth), robot())
    found = read_bag(tmp_path / name, robot()).truth
    assert not found.has_heading
    np.testing.assert_array_equal(found.poses, truth.poses)


def test_wheels_and_arm_may_share_a_topic(tmp_path, rng):
    both = robot(topics=Topics(wheels="/joint_states", joints="/joint_states", truth="/truth", fixes="/fixes"))
    written = recording(rng, 3.0, WheelTicks)
    write_bag(tmp_path / "run.mcap", written, both)
    found = read_bag(tmp_path / "run.mcap", both)
    assert (len(found.wheels), len(found.joints)) == (30, 30)
    assert found.joints[0].names == ("shoulder", "elbow")


@pytest.mark.parametrize("name", FORMATS)
def test_a_bag_that_fails_half_way_leaves_nothing(tmp_path, rng, name):
    def fail(fraction):
        if fraction > 0:
            raise KeyboardInterrupt

    wheels = tuple(WheelTicks(0.01 * i, rng.normal(size=4)) for i in range(600))
    with pytest.raises(KeyboardInterrupt):
        write_bag(tmp_path / name, Recording(name="run", wheels=wheels), robot(), fail)
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_replaced_and_a_folder_is_not(tmp_path, rng):
    for name in ("run.bag", "run.mcap"):
        (tmp_path / name).write_text("old")
        write_bag(tmp_path / name, recording(rng, 3.0, WheelTicks), robot())
        assert len(read_bag(tmp_path / name, robot()).wheels) == 30
    (tmp_path / "run").mkdir()
    with pytest.raises(RecordingError, match="is there already; remove it"):
        write_bag(tmp_path / "run", recording(rng, 3.0, WheelTicks), robot())


def test_an_unknown_suffix_is_refused(tmp_path, rng):
    with pytest.raises(RecordingError, match=r"end it with \.mcap or \.bag"):
        write_bag(tmp_path / "run.txt", recording(rng, 3.0, WheelTicks), robot())


def test_a_stamp_that_ros_cannot_hold_is_refused(tmp_path, rng):
    with pytest.raises(RecordingError, match=r"ROS cannot hold the stamp -1\.0 s"):
        write_bag(tmp_path / "run.bag", recording(rng, -1.0, WheelTicks), robot())
    assert list(tmp_path.iterdir()) == []


def test_wheels_without_a_base_that_names_them_are_refused(tmp_path, rng):
    with pytest.raises(RecordingError, match="no base that names the wheels"):
        write_bag(tmp_path / "run.bag", recording(rng, 1.0, WheelTicks), RobotDescription(name="r"))


def messages_of(path):
    """topic → its messages, read with the types that the bag itself defines."""
    found = {}
    with AnyReader([path]) as bag:
        for connection, _, raw in bag.messages():
            found.setdefault(connection.topic, []).append(bag.deserialize(raw, connection.msgtype))
    return found


def placed(message):
    t, q = message.transform.translation, message.transform.rotation
    return [t.x, t.y, t.z, 2 * math.atan2(q.z, q.w)]


@pytest.mark.parametrize("name", FORMATS)
def test_what_was_planned_thought_and_reached_is_written_beside_what_was_measured(tmp_path, rng, name):
    written = recording(rng, 1.0, WheelTicks)
    q = rng.normal(size=(5, 2))
    plan = ConfigurationTrajectory(np.array([1.0, 1.1, 1.25, 1.3, 1.5]), q, ("shoulder", "elbow"))
    thought = PoseTrajectory(1.0 + 0.1 * np.arange(4), rng.uniform(-3, 3, (4, 3)), np.tile(0.1 * np.eye(3), (4, 1, 1)))
    T = se3.exp(rng.normal(size=(4, 6)))
    tool = {"truth": Reference(thought.stamps, tool=T), "estimate": Reference(thought.stamps, tool=T)}
    write_bag(tmp_path / name, written, robot(), plan=plan, estimate=thought, tool=tool)
    assert_same_recording(read_bag(tmp_path / name, robot()), written)
    found = messages_of(tmp_path / name)
    (told,) = found["/joint_trajectory"]
    assert list(told.joint_names) == ["shoulder", "elbow"]
    np.testing.assert_array_equal([p.positions for p in told.points], q)
    np.testing.assert_array_equal([p.velocities for p in told.points], plan.velocities)
    since = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in told.points]
    np.testing.assert_allclose(since, plan.stamps - 1.0, atol=1e-9)
    last = found["/odometry/filtered"][-1]
    assert (last.header.frame_id, last.child_frame_id) == ("map", "base_link")
    assert last.pose.pose.position.x == pytest.approx(thought.poses[-1, 0], abs=1e-15)
    assert last.pose.covariance[35] == pytest.approx(0.1)
    moved = [placed(m.transforms[0]) for m in found["/tf"]]
    np.testing.assert_allclose(moved, np.insert(thought.poses, 2, 0.0, axis=1), atol=1e-12)
    assert [t.child_frame_id for t in found["/tf_static"][0].transforms] == ["front", "imu_link"]
    p = found["/tool/truth"][2].pose.position
    np.testing.assert_allclose([p.x, p.y, p.z], T[2, :3, 3], atol=1e-15)
    assert len(found["/tool/estimate"]) == 4


def test_without_an_estimate_the_transforms_say_the_truth(tmp_path, rng):
    written = recording(rng, 1.0, WheelTicks)
    write_bag(tmp_path / "run.mcap", written, robot())
    moved = [placed(m.transforms[0]) for m in messages_of(tmp_path / "run.mcap")["/tf"]]
    np.testing.assert_allclose(moved, np.insert(written.truth.poses, 2, 0.0, axis=1), atol=1e-12)


def test_joints_and_wrenches_come_back_for_a_description_that_names_no_topics(tmp_path, rng):
    written = recording(rng, 1.0, WheelTicks)
    write_bag(tmp_path / "run.mcap", written, robot(topics=Topics()))
    found = read_bag(tmp_path / "run.mcap", robot(topics=Topics()))
    assert (len(found.joints), len(found.wrenches), found.remarks) == (30, 30, ())
    np.testing.assert_array_equal(found.joints[3].effort, written.joints[3].effort)


def test_an_estimate_in_a_bag_is_not_taken_for_wheels_or_fixes(tmp_path, rng):
    bare = RobotDescription(name="r", topics=Topics(fixes="/gps"))
    twists = tuple(Odometry(0.1 * i, twist=rng.normal(size=3)) for i in range(1, 5))
    path = PoseTrajectory(np.arange(1.0, 5.0), np.zeros((4, 3)))
    tool = {"truth": Reference(path.stamps, tool=np.tile(np.eye(4), (4, 1, 1)))}
    write_bag(tmp_path / "run.mcap", Recording(name="run", wheels=twists), bare, estimate=path, tool=tool)
    found = read_bag(tmp_path / "run.mcap", bare)
    assert len(found.wheels) == 4
    assert found.remarks == ("There is no topic /gps, so the recording is read without fixes.",)


def test_any_standard_message_can_be_written(tmp_path):
    with new_bag(tmp_path / "run.mcap") as bag:
        bag.write("/imu", imu(bag.types, 1.0, Imu(1.0, np.ones(3), np.zeros(3))), 2.0)
        bag.write("/text", bag.types["std_msgs/msg/String"]("hello"), 1.0)
    assert read_bag(tmp_path / "run.mcap", robot(topics=Topics())).imu[0].stamp == 1.0


def test_ros_knows_the_types_that_are_written(tmp_path, rng):
    """AnyReader compares each definition with its hash; those of ROS 1 are also what ROS itself says they are."""
    for name in FORMATS:
        write_bag(tmp_path / name, recording(rng, 1.0, WheelTicks), robot())
        with AnyReader([tmp_path / name]) as bag:
            digests = {c.msgtype: c.digest for c in bag.connections}
        if name.endswith(".bag"):
            assert digests["tf2_msgs/msg/TFMessage"] == "94810edda583a504dfda3829e70d7eec"
            assert digests["sensor_msgs/msg/JointState"] == "3066dcd76a6cfaef579bd0f34173e9fd"
            assert digests["sensor_msgs/msg/LaserScan"] == "90c7ef2dc6895d81024acba2ac42f369"
