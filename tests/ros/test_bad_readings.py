"""Bad messages on ROS topics: the sentences of a bag with them, counted, and the estimate goes on."""

from ros_clients import told_of_bad_readings

from longreach.io.config import load_description
from longreach.sim.kinematic import make_recording


def test_bad_messages_are_told_in_the_diagnostics_and_stop_nothing(nodes, other):
    thing = load_description("thing")
    recording = make_recording(thing, seed=4, duration=11.5, lidar_rate=5.0, beams=90)
    with nodes("estimate", "--robot", "thing", "--no-tf"):
        said, came = other(told_of_bad_readings, thing, recording)
    said = "\n".join(said)
    for words in (
        "messages of /imu/data cannot be used and were left out: each has an angular velocity that is not finite.",
        "messages of /imu/data cannot be used and were left out: each has a stamp that is not after the one before.",
        "messages of /joint_states cannot be used and were left out: each names 4 joints but has 3 positions.",
        "Half of the ranges are beyond",
    ):
        assert words in said, said
    assert came > 200
