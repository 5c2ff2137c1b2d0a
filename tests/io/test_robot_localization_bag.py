"""What a robot_localization node would have heard, out of bags of every kind."""

import numpy as np
import pytest
import spatial_bags
from spatial_bags import MOUNT, START, U

from longreach.errors import ConfigError, RecordingError
from longreach.geometry import se3
from longreach.io import messages
from longreach.io.robot_localization import read_parameters
from longreach.io.robot_localization_bag import parse_transform, read_spatial_recording
from longreach.spatial_measurement import AccelerationReading, PoseReading, TwistReading


@pytest.fixture
def settings(tmp_path):
    def of(text=spatial_bags.PARAMETERS, **changes):
        (tmp_path / "p.yaml").write_text(text)
        return read_parameters(tmp_path / "p.yaml", changes=changes).settings

    return of


@pytest.fixture
def recorded(tmp_path, settings):
    def of(name="a.bag", transforms=(MOUNT,), changes=None, text=spatial_bags.PARAMETERS, **options):
        spatial_bags.write(tmp_path / name, **options)
        return read_spatial_recording(tmp_path / name, settings(text, **(changes or {})), transforms)

    return of


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a"])
def test_every_kind_of_bag_gives_the_same_readings(recorded, name):
    r = recorded(name)
    kinds = [type(reading) for reading in r.readings]
    assert kinds[:3] == [TwistReading, PoseReading, TwistReading]
    assert len(kinds) == 3 * spatial_bags.COUNT
    first, orientation, rates = r.readings[:3]
    assert (first.source, first.frame, first.stamp) == ("odom0", "base_link", START)
    np.testing.assert_allclose(first.twist, U, atol=1e-12)
    np.testing.assert_allclose(orientation.pose[:3, :3], spatial_bags.mount()[:3, :3], atol=1e-9)
    np.testing.assert_allclose(rates.twist[3:], spatial_bags.mount()[:3, :3].T @ U[3:], atol=1e-12)
    np.testing.assert_allclose(r.mounts["imu_link"], spatial_bags.mount(), atol=1e-9)
    np.testing.assert_array_equal(r.mounts["base_link"], np.eye(4))


def test_accelerations_come_with_the_orientation_if_there_is_one(recorded):
    mask = [False] * 12 + [True] * 3
    for known in (True, False):
        r = recorded(f"{known}.bag", changes={"imu0_config": mask}, known=known)
        found = [reading for reading in r.readings if isinstance(reading, AccelerationReading)]
        assert len(found) == spatial_bags.COUNT
        assert (found[0].attitude is not None) == known


def test_poses_and_twists_of_their_own_topics_are_read(recorded):
    def more(bag):
        head = messages.header(bag.types, START, "map")
        stamped = bag.types["geometry_msgs/msg/PoseWithCovarianceStamped"]
        bag.write("/ns/pose", stamped(head, spatial_bags.pose(bag.types, np.eye(4))), START + 9)
        stamped = bag.types["geometry_msgs/msg/TwistWithCovarianceStamped"]
        bag.write("/twist", stamped(messages.header(bag.types, START, ""), spatial_bags.twist(bag.types, U)), START + 9)

    ones = [True] * 15
    changes = {"pose0": "pose", "pose0_config": ones, "twist0": "twist", "twist0_config": ones}
    pose, twist = recorded(more=more, changes=changes, transforms=(MOUNT, "odom:map=1,2,3,0,0,0")).readings[-2:]
    assert (pose.source, pose.frame) == ("pose0", "map")
    assert (twist.source, twist.frame) == ("twist0", "")


def test_commands_are_read_for_the_control(recorded):
    def more(bag):
        told = spatial_bags.twist(bag.types, U).twist
        bag.write("/cmd_vel", told, START + 9)

    changes = {"use_control": True, "control_config": [True] * 6}
    (command,) = recorded(more=more, changes=changes).commands
    assert command.stamp == START + 9
    np.testing.assert_array_equal(command.twist, U)


def test_frames_come_from_the_recordings_tf(recorded):
    def more(bag):
        T, types = spatial_bags.mount(), bag.types
        turn = types["geometry_msgs/msg/Quaternion"](*map(float, spatial_bags.quaternion(T[:3, :3])))
        fixed = types["geometry_msgs/msg/Transform"](spatial_bags.vector(types, T[:3, 3]), turn)
        stamped = types["geometry_msgs/msg/TransformStamped"]
        head = messages.header(types, START, "base_link")
        bag.write("/tf_static", types["tf2_msgs/msg/TFMessage"]([stamped(head, "imu_link", fixed)]), START)

    r = recorded(more=more, transforms=())
    np.testing.assert_allclose(r.mounts["imu_link"], spatial_bags.mount(), atol=1e-9)
    given = recorded("b.bag", more=more, transforms=("base_link:imu_link=1,2,3,0,0,0",))
    np.testing.assert_allclose(
        given.mounts["imu_link"], se3.from_rotation_translation(np.eye(3), np.array([1.0, 2, 3]))
    )


def test_a_frame_that_nobody_knows_is_named_with_what_to_do(recorded):
    said = "imu0 is in the frame imu_link, which nothing in the recording fixes to base_link; say where it is by "
    with pytest.raises(RecordingError, match=f"{said}--transform base_link:imu_link=x,y,z,roll,pitch,yaw"):
        recorded(transforms=())


def test_a_topic_that_is_missing_is_said_and_none_at_all_refused(recorded):
    r = recorded(changes={"odom0": "/wheels"})
    assert r.remarks == ("The recording has no topic /wheels, so it is estimated without odom0.",)
    with pytest.raises(RecordingError, match=r"none of the topics to fuse \(/wheels, /imu\); it has /imu/data"):
        recorded("b.bag", changes={"odom0": "/wheels", "imu0": "/imu"})


def test_a_topic_of_another_type_is_refused(recorded):
    with pytest.raises(RecordingError, match="/odom for imu0 must be one sensor_msgs/msg/Imu, but there is /odom"):
        recorded(changes={"imu0": "/odom"})


@pytest.mark.parametrize(
    "text", ["base_link=1,2,3,4,5,6", "a:b=1,2,3", "a:b=1,2,3,4,5,x", "a:a=0,0,0,0,0,0", "a:b=1,2,3,4,5,nan"]
)
def test_a_transform_of_another_form_is_refused(text):
    with pytest.raises(ConfigError, match="is no transform; write PARENT:CHILD=x,y,z,roll,pitch,yaw in metres"):
        parse_transform(text)
