"""A recording and a reference are read whatever their format."""

import numpy as np
import pytest

from longreach.errors import RecordingError
from longreach.io.bag_writer import write_bag
from longreach.io.config import load_description
from longreach.io.inspect import inspect_recording
from longreach.io.recording import read_recording
from longreach.io.trajectory_file import read_poses
from longreach.io.tum import write_tum
from longreach.sim.kinematic import make_recording
from longreach.trajectory import PoseTrajectory

THING = load_description("thing")
FLASER = "FLASER 3 1 2 3 0.5 0.6 0.7 0.1 0.2 0.3 {stamp} nohost {stamp}\n"


@pytest.fixture
def carmen(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("".join(FLASER.format(stamp=stamp) for stamp in (1.0, 1.2)))
    return path


@pytest.fixture
def brenner(tmp_path):
    for name, line in {"motors": "M 1000 1 0 0 0 2 0 0 0", "scan": "S 1000 1 500", "reference": "P 1000 1 2"}.items():
        (tmp_path / f"a_{name}.txt").write_text(line + "\n")
    return tmp_path


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a"])
def test_a_made_recording_comes_back_from_every_kind_of_bag(tmp_path, name):
    made = make_recording(THING, duration=1.0, beams=20)
    write_bag(tmp_path / name, made, THING)
    found = read_recording(tmp_path / name, THING)
    for kind in ("wheels", "scans", "imu"):
        assert [r.stamp for r in getattr(found, kind)] == pytest.approx([r.stamp for r in getattr(made, kind)])
    np.testing.assert_allclose(found.truth.poses, made.truth.poses, atol=1e-9)
    assert {"/joint_states", "/front/scan", "/imu/data"} <= {t.topic for t in inspect_recording(tmp_path / name).topics}


def test_logs_and_folders_are_read(carmen, brenner):
    assert len(read_recording(carmen, load_description("intel")).scans) == 2
    assert len(read_recording(brenner, load_description("brenner")).scans) == 1
    assert inspect_recording(carmen).format == "CARMEN log"
    assert inspect_recording(brenner).format == "text files"


def test_a_topic_of_what_has_none_is_refused(carmen):
    with pytest.raises(RecordingError, match=r"has no topics, so there is no /truth; give the reference as a file"):
        read_recording(carmen, load_description("intel"), truth_topic="/truth")


def test_references_are_told_by_their_first_line(tmp_path, carmen, brenner):
    write_tum(tmp_path / "a.tum", PoseTrajectory(np.array([3.0]), np.array([[1.0, 2.0, 0.5]])))
    np.testing.assert_allclose(read_poses(tmp_path / "a.tum")[0].poses, [[1.0, 2.0, 0.5]], atol=1e-11)
    np.testing.assert_allclose(read_poses(carmen)[0].poses[0], [0.5, 0.6, 0.7])
    np.testing.assert_allclose(read_poses(brenner / "a_reference.txt")[0].poses, [[0.001, 0.002, 0.0]])


@pytest.mark.parametrize("text", ["", "# a comment\n"])
def test_an_empty_reference_is_refused(tmp_path, text):
    (tmp_path / "a.tum").write_text(text)
    with pytest.raises(RecordingError, match="holds no poses"):
        read_poses(tmp_path / "a.tum")
