"""What a recording is said to hold."""

import numpy as np
import pytest

from longreach.io import messages
from longreach.io.bag_info import inspect
from longreach.io.bag_writer import new_bag
from longreach.io.recording_info import topic_info
from longreach.measurement import Imu


def test_a_topic_is_timed_by_its_stamps_whatever_their_order():
    found = topic_info("/a", "b", np.array([0.0, 0.1, 0.3, 0.2, 1.0]))
    assert (found.topic, found.type, found.count, found.backward_stamps) == ("/a", "b", 5, 1)
    assert found.rate == pytest.approx(4.0)
    assert found.longest_gap == pytest.approx(0.7)


@pytest.mark.parametrize("stamps", [[], [3.0], [3.0, 3.0]])
def test_a_topic_without_duration_has_no_rate(stamps):
    found = topic_info("/a", "b", np.array(stamps))
    assert (found.count, found.rate, found.longest_gap) == (len(stamps), 0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "format"), [("run.bag", "ROS 1 bag"), ("run.mcap", "MCAP"), ("run", "ROS 2 bag"), ("odd", "MCAP")]
)
def test_a_bag_is_told_by_its_headers_and_where_there_are_none_by_the_time_of_recording(tmp_path, name, format):
    path = tmp_path / ("run.mcap" if name == "odd" else name)
    with new_bag(path) as bag:
        for i, stamp in enumerate([10.0, 10.1, 10.05, 10.5]):
            message = messages.imu(bag.types, stamp, Imu(stamp, np.zeros(3), np.zeros(3)))
            bag.write("/imu", message, 100.0 + i)
            bag.write("/unset", messages.joint_state(bag.types, 0.0, []), 100.0 + 2 * i)
            bag.write("/text", bag.types["std_msgs/msg/String"]("x"), 100.0 + i)
    if name == "odd":
        path = path.rename(tmp_path / "odd")
    found = inspect(path)
    imu, text, unset = found.topics
    assert (found.format, found.start) == (format, 100.0)
    assert found.duration == pytest.approx(6.0)
    assert (imu.topic, imu.type, imu.count, imu.backward_stamps) == ("/imu", "sensor_msgs/msg/Imu", 4, 1)
    assert (imu.rate, imu.longest_gap) == (pytest.approx(6.0), pytest.approx(0.4))
    assert (text.type, text.rate) == ("std_msgs/msg/String", pytest.approx(1.0))
    assert unset.rate == pytest.approx(0.5)
    assert found.remarks == ("The messages of /unset have no stamps; the time of recording is taken.",)
