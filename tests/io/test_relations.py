"""Relations are read as they stand, in whatever order, forwards and backwards in time."""

import gzip

import numpy as np
import pytest

from longreach.errors import RecordingError
from longreach.io.relations import read_relations

LINES = "976052905.1 976052911.8 -0.05 -0.12 9 9 9 -1.6\n# no line\n\n976052896.7 976052890.1 0.1 0.2 0 0 0 0.3\n"


@pytest.mark.parametrize("name", ["a.relations", "a.relations.gz"])
def test_relations_are_read_in_the_order_of_the_file(tmp_path, name):
    (tmp_path / name).write_bytes(gzip.compress(LINES.encode()) if name.endswith("gz") else LINES.encode())
    t1, t2, poses = read_relations(tmp_path / name)
    np.testing.assert_array_equal(t1, [976052905.1, 976052896.7])
    np.testing.assert_array_equal(t2, [976052911.8, 976052890.1])
    np.testing.assert_array_equal(poses, [[-0.05, -0.12, -1.6], [0.1, 0.2, 0.3]])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("1 2 3 4 5 6 7 8\n1 2 3\n", "line 2: a relation is t1 t2 x y z roll pitch yaw, 8 finite numbers"),
        ("1 2 3 4 5 6 7 inf\n", "line 1: a relation is"),
        ("1 2 3 4 5 6 7 eight\n", "line 1: 'eight' is not a number"),
        ("# only a comment\n", "holds no relations"),
    ],
)
def test_what_is_no_relation_is_said(tmp_path, text, sentence):
    (tmp_path / "a.relations").write_text(text)
    with pytest.raises(RecordingError, match=sentence):
        read_relations(tmp_path / "a.relations")
