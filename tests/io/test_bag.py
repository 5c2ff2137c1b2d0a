"""What is read from which topic of a bag, with which stamps."""

import numpy as np
import pytest

from longreach.errors import ConfigError, RecordingError
from longreach.geometry import se3
from longreach.io import messages
from longreach.io.bag import read_bag
from longreach.io.bag_info import inspect
from longreach.io.bag_writer import new_bag
from longreach.measurement import Imu, LaserScan, Odometry, PoseMeasurement, WheelSpeeds, WheelTicks
from longreach.robot.bases import DifferentialBase
from longreach.robot.description import Encoder, RobotDescription, Topics

WHEELS = ("left", "right")
AT_THE_BASE = (
    "Nothing says where the lidar is mounted (laser: no transform names a base_link); it is taken to stand at "
    "base_link, looking ahead. Give lidar.mount in the robot's description.",
)


def robot(signal="angle", base=True, **topics):
    return RobotDescription(
        name="r",
        base=DifferentialBase(wheel_radius=0.1, track_width=0.5, wheel_names=WHEELS) if base else None,
        encoder=Encoder(signal=signal, counts_per_revolution=100.0),
        topics=Topics(**topics),
    )


class Bag:
    """Builds a bag from (topic, message, time of recording)."""

    def __init__(self, path):
        self.path, self.rows = path, []

    def joints(self, topic, stamp, names, position=None, velocity=None, at=None):
        return self.add(topic, lambda t: messages.joint_state(t, stamp, names, position, velocity), at or stamp)

    def odometry(self, topic, stamp, pose):
        record = Odometry(stamp, np.array(pose, dtype=float))
        return self.add(topic, lambda t: messages.odometry(t, stamp, record), stamp)

    def pose(self, topic, stamp, pose):
        return self.add(topic, lambda t: messages.pose_stamped(t, stamp, np.array(pose, dtype=float)), stamp)

    def scan(self, topic, stamp, frame="laser"):
        record = LaserScan(stamp, np.ones(3), 0.0, 0.1, frame=frame)
        return self.add(topic, lambda t: messages.laser_scan(t, stamp, record), stamp)

    def transforms(self, topic, stamp, child, parent, T):
        def make(types):
            message = messages.transforms(types, stamp, {child: T})
            message.transforms[0].header.frame_id = parent
            return message

        return self.add(topic, make, stamp)

    def add(self, topic, make, at):
        self.rows.append((topic, make, at))
        return self

    def read(self, robot, **options):
        self.path.unlink(missing_ok=True) if self.path.suffix == ".mcap" else None
        with new_bag(self.path) as bag:
            for topic, make, at in self.rows:
                bag.write(topic, make(bag.types), at)
        return read_bag(self.path, robot, **options)


@pytest.fixture(params=["run.bag", "run.mcap", "run"])
def bag(request, tmp_path):
    return Bag(tmp_path / request.param)


@pytest.fixture
def mcap(tmp_path):
    return Bag(tmp_path / "run.mcap")


def test_wheels_are_picked_by_name_in_the_order_of_the_base(bag):
    bag.joints("/j", 1.0, ["right", "arm", "left"], np.array([2.0, 9.0, 1.0]), np.array([20.0, 90.0, 10.0]))
    found = bag.read(robot())
    assert isinstance(found.wheels[0], WheelTicks)
    np.testing.assert_array_equal(found.wheels[0].ticks, [1.0, 2.0])
    speeds = read_bag(bag.path, robot("speed")).wheels[0]
    assert isinstance(speeds, WheelSpeeds)
    np.testing.assert_array_equal(speeds.speeds, [10.0, 20.0])


@pytest.mark.parametrize("names", [[], ["l", "r"]])
def test_wheels_without_their_names_are_taken_in_order_if_the_count_is_right(mcap, names):
    mcap.joints("/j", 1.0, names, np.array([1.0, 2.0]))
    np.testing.assert_array_equal(mcap.read(robot()).wheels[0].ticks, [1.0, 2.0])


def test_messages_of_other_joints_on_the_wheels_topic_are_not_wheels(mcap):
    mcap.joints("/j", 1.0, ["finger_1", "finger_2"], np.array([7.0, 8.0]))
    mcap.joints("/j", 2.0, ["left", "right"], np.array([1.0, 2.0]))
    mcap.joints("/j", 3.0, ["a", "b", "c"], np.zeros(3))
    assert [w.stamp for w in mcap.read(robot()).wheels] == [2.0]


def test_of_several_joint_topics_that_with_the_wheels_names_is_taken(mcap):
    mcap.joints("/arm", 1.0, ["a", "b"], np.zeros(2)).joints("/base", 1.0, ["left", "right"], np.array([1.0, 2.0]))
    mcap.odometry("/odom", 1.0, [0, 0, 0])
    np.testing.assert_array_equal(mcap.read(robot()).wheels[0].ticks, [1.0, 2.0])


def test_several_topics_that_may_be_the_wheels_are_named(mcap):
    mcap.odometry("/odom_1", 1.0, [0, 0, 0]).odometry("/odom_2", 1.0, [0, 0, 0])
    with pytest.raises(
        RecordingError, match=r"/odom_1 \(nav_msgs/msg/Odometry\), /odom_2 .* name one as topics.wheels"
    ):
        mcap.read(robot(base=False))
    assert len(read_bag(mcap.path, robot(base=False, truth="/odom_1")).wheels) == 1  # the other one is taken


def test_a_robot_without_a_base_has_odometry_for_wheels(mcap):
    mcap.joints("/arm", 1.0, ["a", "b"], np.zeros(2)).odometry("/odom", 1.0, [1, 2, 0.5])
    found = mcap.read(robot(base=False))
    np.testing.assert_allclose(found.wheels[0].pose, [1, 2, 0.5])
    with pytest.raises(RecordingError, match=r"no base that names the wheels"):
        read_bag(mcap.path, robot(base=False, wheels="/arm"))


def test_wheels_that_are_nowhere_in_their_topic_are_an_error(mcap):
    mcap.joints("/j", 1.0, ["a", "b", "c"], np.zeros(3))
    with pytest.raises(RecordingError, match=r"No message of /j has the position of left, right"):
        mcap.read(robot())


def test_joints_that_are_no_wheels_do_not_keep_the_lidar_from_being_read(mcap):
    found = mcap.joints("/arm", 1.0, ["a", "b", "c"], np.zeros(3)).scan("/scan", 1.0).read(robot())
    assert (len(found.wheels), len(found.scans)) == (0, 1)
    assert found.remarks == (
        "1 messages of /arm cannot be used and were left out: each has no joint that is looked for.",
        *AT_THE_BASE,
    )


def test_a_named_topic_that_is_missing_is_an_error_that_tells_what_is_there(mcap):
    mcap.joints("/j", 1.0, WHEELS, np.zeros(2)).scan("/scan", 1.0)
    with pytest.raises(
        RecordingError, match=r"no topic /nope for wheels; it has /j \(sensor_msgs/msg/JointState\), /scan"
    ):
        mcap.read(robot(wheels="/nope"))
    with pytest.raises(RecordingError, match=r"no topic /nope for truth; it has /j"):
        read_bag(mcap.path, robot(), truth_topic="/nope")


def test_a_sensor_that_the_bag_has_none_of_is_only_a_remark(mcap):
    found = mcap.joints("/j", 1.0, WHEELS, np.zeros(2)).read(robot(imu="/imu", truth="/truth"))
    assert found.remarks == (
        "There is no topic /imu, so the recording is read without imu.",
        "There is no topic /truth, so the recording is read without truth.",
    )


def test_a_topic_of_the_wrong_type_is_an_error(mcap):
    mcap.joints("/j", 1.0, WHEELS, np.zeros(2))
    with pytest.raises(RecordingError, match=r"/j is of type sensor_msgs/msg/JointState, but lidar are read from"):
        mcap.read(robot(lidar="/j"))


def test_truth_fixes_and_joints_are_read_only_if_named(bag):
    fix = PoseMeasurement(1.0, np.array([1.0, 2.0, 0.5]), np.diag([0.1, 0.2, 0.3]))
    bag.joints("/j", 1.0, WHEELS, np.zeros(2)).joints("/arm", 1.0, ["a"], np.ones(1)).pose("/p", 1.0, [1, 2, 3])
    bag.add("/fix", lambda t: messages.pose_with_covariance(t, 1.0, fix), 1.0)
    found = bag.read(robot())
    assert (found.truth, found.fixes, found.joints) == (None, (), ())
    found = read_bag(bag.path, robot(truth="/nope", fixes="/fix", joints="/arm"), truth_topic="/p")
    np.testing.assert_allclose(found.truth.poses, [[1, 2, 3]])
    np.testing.assert_allclose(found.fixes[0].covariance, fix.covariance)
    assert found.joints[0].names == ("a",)


def test_fixes_that_do_not_tell_how_good_they_are_are_a_remark(mcap):
    mcap.joints("/j", 1.0, WHEELS, np.zeros(2)).pose("/p", 1.0, [1, 2, 3])
    remark = "1 fixes of /p have no covariance; they are taken to be good to 0.01 m, 0.01 rad."
    assert mcap.read(robot(fixes="/p")).remarks == (remark,)


@pytest.mark.parametrize("kind", ["pose", "odometry", "covariance", "transform", "tf"])
def test_the_truth_may_be_of_any_type_with_a_pose(mcap, kind):
    mcap.joints("/j", 1.0, WHEELS, np.zeros(2))
    pose, T = np.array([1.0, 2.0, 0.5]), se3.exp(np.array([0, 0, 0, 0, 0, 0.5]))
    T[:2, 3] = pose[:2]
    fix = PoseMeasurement(1.0, pose, np.eye(3))
    if kind == "tf":
        mcap.transforms("/t", 1.0, "marker", "world", np.eye(4)).transforms("/t", 1.5, "base_link", "world", T)
    elif kind == "transform":
        mcap.add("/t", lambda t: messages.transforms(t, 1.5, {"base_link": T}).transforms[0], 1.5)
    elif kind == "covariance":
        mcap.add("/t", lambda t: messages.pose_with_covariance(t, 1.5, fix), 1.5)
    else:
        (mcap.pose if kind == "pose" else mcap.odometry)("/t", 1.5, pose)
    truth = mcap.read(robot(), truth_topic="/t").truth
    np.testing.assert_allclose(truth.poses, [pose])
    assert truth.stamps.tolist() == [1.5]


def test_a_truth_of_several_frames_without_base_link_is_ambiguous(mcap):
    mcap.joints("/j", 1.0, WHEELS, np.zeros(2))
    mcap.transforms("/tf", 1.0, "a", "world", np.eye(4)).transforms("/tf", 1.5, "b", "world", np.eye(4))
    with pytest.raises(RecordingError, match=r"/tf has several frames and none is base_link: a, b"):
        mcap.read(robot(), truth_topic="/tf")


def test_mounts_follow_the_tree_of_frames_that_do_not_move(bag, rng):
    A, B, C = (se3.exp(rng.normal(size=6)) for _ in range(3))
    bag.scan("/scan", 1.0, "/front_laser").add(
        "/imu", lambda t: messages.imu(t, 1.0, Imu(1.0, np.zeros(3), np.ones(3), "imu_link")), 1.0
    )
    bag.transforms("/tf_static", 0.5, "top_plate", "base_link", A).transforms("/tf_static", 0.6, "base_link", "foot", C)
    bag.transforms("/tf", 0.7, "front_laser", "top_plate", B).transforms("/tf", 0.8, "front_laser", "top_plate", B)
    bag.transforms("/tf", 0.7, "foot", "odom", A).transforms("/tf", 0.8, "foot", "odom", B)  # the robot itself moves
    bag.transforms("/tf_static", 0.9, "imu_link", "foot", B)
    mounts = bag.read(robot()).mounts
    assert mounts.keys() == {"front_laser", "imu_link"}
    np.testing.assert_allclose(mounts["front_laser"], A @ B, atol=1e-12)
    np.testing.assert_allclose(mounts["imu_link"], se3.inverse(C) @ B, atol=1e-12)


def test_a_sensor_that_moves_in_the_base_has_no_mount(mcap, rng):
    mcap.scan("/scan", 1.0, "laser").transforms("/tf", 0.5, "laser", "base_link", np.eye(4))
    mcap.transforms("/tf", 0.6, "laser", "base_link", se3.exp(rng.normal(size=6)))
    found = mcap.read(robot())
    assert found.mounts == {}
    assert "(laser: it moves in base_link); it is taken to stand at base_link" in found.remarks[0]


def test_headers_without_stamps_take_the_time_of_recording(bag):
    for i in range(3):
        bag.joints("/j", 0.0, WHEELS, np.zeros(2), at=100.0 + i)
    found = bag.read(robot())
    assert [w.stamp for w in found.wheels] == [100.0, 101.0, 102.0]
    assert found.remarks == ("3 messages of /j have no stamp; the time of recording is taken.",)


def test_a_clock_that_begins_at_zero_is_taken_as_it_is(mcap):
    for i in range(3):
        mcap.joints("/j", 0.1 * i, WHEELS, np.zeros(2), at=100.0 + i)
    found = mcap.read(robot())
    assert [w.stamp for w in found.wheels] == [0.0, 0.1, 0.2]
    assert found.remarks == ()


def test_headers_that_run_backwards_are_repaired_in_the_order_of_the_file(bag):
    stamps = [1.0, 2.0, 1.5, 3.0, 4.0]
    for i, stamp in enumerate(stamps):
        bag.joints("/j", stamp, WHEELS, np.full(2, float(i)), at=100.0 + i)
    found = bag.read(robot())
    repaired = np.array([w.stamp for w in found.wheels])
    assert [w.ticks[0] for w in found.wheels] == [0, 1, 2, 3, 4]
    assert np.all(np.diff(repaired) > 0)
    assert repaired[[0, 3, 4]].tolist() == [1.0, 3.0, 4.0]
    np.testing.assert_array_equal(found.as_recorded(repaired), stamps)
    assert found.remarks == ("1 stamps of /j run backwards; they were repaired in the order of the file.",)


def test_progress_goes_from_nothing_to_all(mcap):
    for i in range(1200):
        mcap.joints("/j", 0.01 * i, WHEELS, np.zeros(2))
    told = []
    mcap.read(robot(), progress=told.append)
    assert told[0] == 0.0
    assert told[-1] == 1.0
    assert told == sorted(told)
    assert len(told) == 4


def test_topics_that_are_asked_for_come_before_those_of_the_description(mcap):
    mcap.scan("/front", 1.0).scan("/back", 2.0).scan("/back", 3.0)
    assert len(mcap.read(robot(lidar="/front"), topics={"lidar": "/back"}).scans) == 2


@pytest.mark.parametrize(
    ("topics", "error", "said"),
    [
        (
            {"lidar": "/side"},
            RecordingError,
            r"has no topic /side for lidar; it has /front \(sensor_msgs/msg/LaserScan\)",
        ),
        ({"imu": "/front"}, RecordingError, "/front is of type sensor_msgs/msg/LaserScan, but imu are read from"),
        ({"nose": "/front"}, ConfigError, "nose is no sensor that has a topic; there are wheels, lidar, imu, truth"),
    ],
)
def test_a_topic_that_was_asked_for_must_be_there(mcap, topics, error, said):
    mcap.scan("/front", 1.0)
    for read in (lambda: mcap.read(robot(), topics=topics), lambda: inspect(mcap.path, topics=topics)):
        with pytest.raises(error, match=said):
            read()


def test_the_clock_may_be_that_of_the_recording(mcap):
    for stamp, at in ((1.0, 10.0), (0.5, 10.2), (2.0, 10.3)):
        mcap.joints("/j", stamp, WHEELS, np.zeros(2), np.ones(2), at=at)
    mcap.pose("/truth", 5.0, [1.0, 2.0, 0.5])
    found = mcap.read(robot(), clock="record", topics={"truth": "/truth"})
    assert [reading.stamp for reading in found.wheels] == [10.0, 10.2, 10.3]
    assert (found.truth.stamps.tolist(), found.recorded_stamps, found.remarks) == ([5.0], {}, ())
    assert [t.backward_stamps for t in inspect(mcap.path, clock="record").topics] == [0, 0]
    assert [t.backward_stamps for t in inspect(mcap.path).topics] == [1, 0]
