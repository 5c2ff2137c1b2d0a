"""Topics are those of the description, unless another is named; without rospy there is one sentence."""

import pytest

from longreach.errors import ConfigError, LiveError
from longreach.io.config import load_description
from longreach.ros import wire
from longreach.ros.sensors import topic_of, with_topics


def test_topics_are_the_descriptions_or_the_usual_ones_or_those_that_are_named():
    thing = load_description("thing")
    assert topic_of(thing, "lidar") == "/front/scan"
    assert topic_of(thing, "wrench") == "/wrench"
    other = with_topics(thing, ["lidar=/scan", "fixes=/mocap"])
    assert topic_of(other, "lidar") == "/scan"
    assert topic_of(other, "fixes") == "/mocap"
    assert topic_of(other, "imu") == topic_of(thing, "imu")


@pytest.mark.parametrize("given", ["lidar", "lidar=", "camera=/image"])
def test_what_names_no_topic_is_refused(given):
    with pytest.raises(ConfigError, match="give ROLE=TOPIC"):
        with_topics(load_description("thing"), [given])


def test_without_rospy_the_sentence_says_what_to_install(monkeypatch, tmp_path):
    def missing(name):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(wire, "_DEBIAN", tmp_path)
    monkeypatch.setattr(wire, "import_module", missing)
    with pytest.raises(LiveError, match="python3-rospy"):
        wire.rospy.__wrapped__()
