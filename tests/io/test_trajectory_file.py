"""Trajectories as people have them: what a file leaves open is told from its numbers, converted, and said."""

import numpy as np
import pytest

from longreach.errors import ConfigError, RecordingError
from longreach.io.trajectory_file import has_stamps, read_poses
from longreach.io.tum import write_tum
from longreach.trajectory import PoseTrajectory

STAMPS = 1.7e9 + 0.1 * np.arange(40)
HEADING = np.linspace(-0.5, 2.5, 40)
POSES = np.column_stack([np.cumsum(0.1 * np.cos(HEADING)), np.cumsum(0.1 * np.sin(HEADING)), HEADING])
HALF = 0.5 * HEADING
ZERO, ONE = np.zeros(40), np.ones(40)
# Camera axes: x right, y down, z forward.
C = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def turned():
    R = np.zeros((40, 3, 3))
    R[:, 0, 0] = R[:, 1, 1] = np.cos(HEADING)
    R[:, 1, 0], R[:, 0, 1], R[:, 2, 2] = np.sin(HEADING), -np.sin(HEADING), 1.0
    return R


def table(path, *columns, separator=" ", header=""):
    rows = np.column_stack(columns).tolist()
    path.write_text(header + "\n".join(separator.join(repr(v) for v in row) for row in rows) + "\n")
    return path


def quaternions(R):
    """Return x y z w; none of the rotations here turns by half a turn."""
    w = 0.5 * np.sqrt(1.0 + np.trace(R, axis1=1, axis2=2))
    xyz = np.column_stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]])
    return np.column_stack([xyz / (4 * w[:, None]), w])


def is_right(found):
    np.testing.assert_allclose(found.stamps, STAMPS, atol=1e-6)
    np.testing.assert_allclose(found.poses[:, :2], POSES[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * found.poses[:, 2]), np.exp(1j * HEADING), atol=1e-9)


def test_a_file_of_ours_is_read_without_a_remark(tmp_path):
    write_tum(tmp_path / "a.tum", PoseTrajectory(STAMPS, POSES))
    found, remarks = read_poses(tmp_path / "a.tum")
    is_right(found)
    assert remarks == ()


@pytest.mark.parametrize("unit", ["nanoseconds", "microseconds", "milliseconds"])
def test_stamps_of_a_smaller_unit_are_converted_and_said(tmp_path, unit):
    size = {"nanoseconds": 1e9, "microseconds": 1e6, "milliseconds": 1e3}[unit]
    path = table(
        tmp_path / "a.txt", np.round(size * STAMPS), POSES[:, :2], ZERO, ZERO, ZERO, np.sin(HALF), np.cos(HALF)
    )
    found, remarks = read_poses(path)
    is_right(found)
    assert remarks == (f"a.txt: its stamps are in {unit}; they were converted to seconds.",)


def test_nanoseconds_that_begin_at_zero_are_known_by_their_steps(tmp_path):
    stamps = np.round(1e9 * (STAMPS - STAMPS[0]))
    path = table(tmp_path / "a.txt", stamps, POSES[:, :2], ZERO, ZERO, ZERO, np.sin(HALF), np.cos(HALF))
    np.testing.assert_allclose(read_poses(path)[0].stamps, STAMPS - STAMPS[0], atol=1e-6)


def test_quaternions_with_w_first_are_noticed_and_may_be_insisted_on(tmp_path):
    path = table(tmp_path / "a.txt", STAMPS, POSES[:, :2], ZERO, np.cos(HALF), ZERO, ZERO, np.sin(HALF))
    found, remarks = read_poses(path)
    is_right(found)
    (remark,) = remarks
    assert "its quaternions are taken for w x y z: as x y z w, TUM's order, the robot would tip over" in remark
    found, remarks = read_poses(path, assume={"quaternion": "wxyz"})
    is_right(found)
    assert remarks == ()
    _, remarks = read_poses(path, assume={"quaternion": "xyzw"})
    assert ["its poses tip over" in remark for remark in remarks] == [True]


def test_the_first_line_may_name_the_order_of_the_quaternion(tmp_path):
    header = "timestamp,x,y,z,qw,qx,qy,qz\n"
    columns = (STAMPS, POSES[:, :2], ZERO, np.cos(HALF), ZERO, ZERO, np.sin(HALF))
    found, remarks = read_poses(table(tmp_path / "a.csv", *columns, separator=",", header=header))
    is_right(found)
    assert remarks == ()


@pytest.mark.parametrize("more", [0, 9])
def test_the_ground_truth_of_euroc_is_read(tmp_path, more):
    header = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
    columns = (np.round(1e9 * STAMPS), POSES[:, :2], ONE, np.cos(HALF), ZERO, ZERO, np.sin(HALF), np.zeros((40, more)))
    found, remarks = read_poses(table(tmp_path / "data.csv", *columns, separator=",", header=header))
    is_right(found)
    assert remarks == ("data.csv: its stamps are in nanoseconds; they were converted to seconds.",)


def test_a_cameras_axes_are_noticed_and_may_be_insisted_on(tmp_path):
    p = np.column_stack([POSES[:, :2], ZERO]) @ C
    path = table(tmp_path / "a.txt", STAMPS, p, quaternions(C.T @ turned() @ C))
    found, remarks = read_poses(path)
    is_right(found)
    assert "axes are taken for a camera's (x right, y down, z forward): the path stays in the plane of x" in remarks[0]
    is_right(read_poses(path, assume={"axes": "camera"})[0])
    assert not np.allclose(read_poses(path, assume={"axes": "robot"})[0].poses, POSES, atol=0.1)


def test_a_camera_in_a_world_with_z_up_is_noticed(tmp_path):
    path = table(tmp_path / "a.txt", STAMPS, POSES[:, :2], ZERO, quaternions(turned() @ C))
    found, remarks = read_poses(path)
    is_right(found)
    assert "(x right, y down, z forward): y points down all along" in remarks[0]


def test_a_path_straight_ahead_along_z_is_a_cameras(tmp_path):
    along = np.arange(40.0)
    path = table(tmp_path / "a.txt", STAMPS, ZERO, ZERO, along, ZERO, ZERO, ZERO, ONE)
    np.testing.assert_allclose(read_poses(path)[0].poses, np.column_stack([along, ZERO, ZERO]), atol=1e-12)


def kitti(path, p=POSES, R=None):
    T = np.concatenate([turned() if R is None else R, np.column_stack([p[:, :2], ZERO])[:, :, None]], axis=2)
    return table(path, T.reshape(40, 12))


@pytest.mark.parametrize("times", ["times.txt", "00_times.txt", "../sequences/00/times.txt"])
def test_poses_of_kitti_take_the_stamps_beside_them(tmp_path, times):
    (tmp_path / "poses").mkdir()
    path = kitti(tmp_path / "poses" / "00.txt")
    assert not has_stamps(path)
    (path.parent / times).resolve().parent.mkdir(exist_ok=True, parents=True)
    table((path.parent / times).resolve(), STAMPS)
    assert has_stamps(path)
    found, remarks = read_poses(path)
    is_right(found)
    assert remarks == ("00.txt: poses of KITTI have no stamps; those of times.txt are taken, line by line.",) or (
        times == "00_times.txt"
    )
    table((path.parent / times).resolve(), STAMPS[1:])
    with pytest.raises(RecordingError, match=r"has 39 stamps for the 40 poses of .*00\.txt; take its own file"):
        read_poses(path)


def test_twelve_numbers_that_are_no_pose_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="12 numbers a line as KITTI's poses, but they hold no rotations"):
        read_poses(kitti(tmp_path / "00.txt", R=np.ones((40, 3, 3))))


@pytest.mark.parametrize("assume", [{"quaternion": "wxzy"}, {"colour": "red"}])
def test_what_cannot_be_assumed_is_said(tmp_path, assume):
    with pytest.raises(ConfigError, match="is nothing that can be assumed of a trajectory; there are quaternion=xyzw"):
        read_poses(tmp_path / "a.tum", assume=assume)
