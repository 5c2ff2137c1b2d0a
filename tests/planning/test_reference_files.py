"""References from TUM and CSV files."""

import numpy as np
import pytest

from longreach.errors import PlanningError, RecordingError
from longreach.geometry import se3
from longreach.io.reference import read_reference
from longreach.io.tum import write_spatial_tum

HEADER = "stamp,x,y,z,qx,qy,qz,qw,base_x,base_y,base_theta"


def write(tmp_path, text, name="path.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_tum_file_holds_the_tools_poses(tmp_path, rng):
    T = se3.exp(rng.normal(size=(20, 6)))
    write_spatial_tum(tmp_path / "tool.tum", np.arange(20.0), T)
    reference = read_reference(tmp_path / "tool.tum")
    np.testing.assert_allclose(reference.tool, T, atol=1e-11)
    assert reference.base is None


def test_a_table_holds_tool_and_base_in_any_order(tmp_path):
    path = write(tmp_path, "base_theta,base_x,base_y,stamp, qw,qx,qy,qz,x,y,z\n0.1,1,2,5.5, 1,0,0,1,7,8,9\n")
    reference = read_reference(path)
    assert reference.stamps.tolist() == [5.5]
    assert reference.base.tolist() == [[1.0, 2.0, 0.1]]
    np.testing.assert_allclose(reference.tool[0], [[0, -1, 0, 7], [1, 0, 0, 8], [0, 0, 1, 9], [0, 0, 0, 1]], atol=1e-15)


def test_a_table_agrees_with_the_tum_file_of_the_same_poses(tmp_path, rng):
    write_spatial_tum(tmp_path / "tool.tum", np.arange(20.0), se3.exp(2.0 * rng.normal(size=(20, 6))))
    lines = (tmp_path / "tool.tum").read_text().splitlines()[1:]
    path = write(tmp_path, "stamp,x,y,z,qx,qy,qz,qw\n" + "\n".join(line.replace(" ", ",") for line in lines))
    np.testing.assert_allclose(read_reference(path).tool, read_reference(tmp_path / "tool.tum").tool, atol=1e-12)


def test_a_table_may_hold_the_base_alone(tmp_path):
    reference = read_reference(write(tmp_path, "stamp,base_x,base_y,base_theta\n0,1,2,3\n1,1,2,3\n"))
    assert reference.tool is None
    assert len(reference) == 2


@pytest.mark.parametrize(
    ("text", "error", "sentence"),
    [
        ("", RecordingError, "holds no poses"),
        (HEADER + "\n", RecordingError, "holds no poses"),
        ("stamp,x,y\n0,1,2\n", RecordingError, "must name the columns stamp and x y z qx qy qz qw"),
        ("stamp,base_x,base_y,theta\n0,1,2,3\n", RecordingError, "it names stamp base_x base_y theta"),
        ("0,1,2,3\n", RecordingError, "must name the columns"),
        (HEADER + "\n0,1,2,3,0,0,0,1,0,0\n", RecordingError, "line 2: expected 11 finite numbers"),
        (HEADER + "\n0,1,2,3,0,0,0,1,0,0,nan\n", RecordingError, "line 2: expected 11 finite numbers"),
        (HEADER + "\n0,1,2,3,0,0,0,1,0,0,a\n", RecordingError, "line 2: 'a' is not a number"),
        (HEADER + "\n0,1,2,3,0,0,0,0,0,0,0\n", RecordingError, "quaternion of pose 0 is zero"),
        (HEADER + 2 * "\n0,1,2,3,0,0,0,1,0,0,0", PlanningError, "path.csv: The reference's stamps must increase"),
    ],
)
def test_a_table_that_cannot_be_followed_is_refused(tmp_path, text, error, sentence):
    with pytest.raises(error, match=sentence):
        read_reference(write(tmp_path, text))


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(RecordingError, match="is not there"):
        read_reference(tmp_path / "none.csv")
