import hashlib
import io
import json
import zipfile

import numpy as np
import pytest
from pose_graphs import street_graph

from longreach.errors import LongreachError, MappingError
from longreach.mapping.map_file import Map, Session, load_map, save_map
from longreach.mapping.pose_graph import PoseGraph
from longreach.mapping.solver import optimize, optimize_robust
from longreach.measurement import LaserScan

MOUNT = np.array([[1.0, 0.0, 0.0, 0.2], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]])


@pytest.fixture
def map_(rng):
    """A solved map of two sessions with lasers of different size; one closure is withdrawn."""
    graph, _, _ = street_graph(rng, n=60, closures=12, wrong=0.2)
    solved = optimize_robust(graph)
    ranges = rng.uniform(0.5, 9.0, (60, 40))
    ranges[:, 3], ranges[:, 7] = np.nan, np.inf
    scans = [
        LaserScan(
            10.0 + 0.1 * k, r[: 40 - k % 2], -1.5, 0.07, 0.1, 10.0 if k else np.inf, 1e-4, "laser" if k < 30 else "back"
        )
        for k, r in enumerate(ranges)
    ]
    sessions = (
        Session("monday.bag", "thing", {"laser": MOUNT}, {"base": {"kind": "mecanum", "radius": 0.1}}),
        Session("tuesday.bag", "thing", {"back": MOUNT}),
    )
    session = np.repeat([0, 1], 30)
    return Map(solved.graph, solved.weights, tuple(scans), rng.normal(size=(60, 3)), session, sessions)


def assert_same(one, other):
    np.testing.assert_array_equal(one.graph.poses, other.graph.poses)
    for a, b in ((one.graph.odometry, other.graph.odometry), (one.graph.closures, other.graph.closures)):
        for name in ("i", "j", "z", "covariance"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    for name in ("weights", "twists", "session", "stamps"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for a, b in zip(one.scans, other.scans, strict=True):
        np.testing.assert_array_equal(a.ranges, b.ranges)
        for name in ("stamp", "angle_min", "angle_increment", "range_min", "range_max", "time_increment", "frame"):
            assert getattr(a, name) == getattr(b, name)
    for a, b in zip(one.sessions, other.sessions, strict=True):
        assert (a.name, a.robot, a.description) == (b.name, b.robot, b.description)
        assert a.mounts.keys() == b.mounts.keys()
        np.testing.assert_array_equal([*a.mounts.values()], [*b.mounts.values()])


def test_a_map_is_read_as_it_was_written_and_solved_again_to_the_last_bit(map_, tmp_path):
    path = tmp_path / "map.lrmap"
    save_map(path, map_)
    loaded = load_map(path)
    assert_same(map_, loaded)
    np.testing.assert_array_equal(optimize(loaded.graph, loaded.weights).poses, map_.graph.poses)
    start = PoseGraph(map_.graph.poses + 0.01, map_.graph.odometry, map_.graph.closures)
    again = PoseGraph(loaded.graph.poses + 0.01, loaded.graph.odometry, loaded.graph.closures)
    np.testing.assert_array_equal(optimize(start, map_.weights).poses, optimize(again, loaded.weights).poses)


def test_equal_maps_are_equal_files_and_ranges_of_single_precision_take_half_the_place(map_, tmp_path):
    save_map(tmp_path / "one.lrmap", map_)
    save_map(tmp_path / "two.lrmap", load_map(tmp_path / "one.lrmap"))
    one = (tmp_path / "one.lrmap").read_bytes()
    assert one == (tmp_path / "two.lrmap").read_bytes()
    short = [
        LaserScan(s.stamp, s.ranges.astype(np.float32), s.angle_min, s.angle_increment, frame=s.frame)
        for s in map_.scans
    ]
    single = Map(map_.graph, map_.weights, tuple(short), map_.twists, map_.session, map_.sessions)
    save_map(tmp_path / "single.lrmap", single)
    assert_same(single, load_map(tmp_path / "single.lrmap"))
    assert len((tmp_path / "single.lrmap").read_bytes()) < len(one) - 0.4 * 8 * sum(len(s.ranges) for s in short)


def written(path, members):
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def version_1():
    """The members of a map file of version 1, as that version was defined: two keyframes and one odometry edge."""
    keyframes = npz(
        stamps=np.array([1.0, 2.0]),
        session=np.array([0, 0]),
        twists=np.zeros((2, 3)),
        beams=np.array([2, 3]),
        ranges=np.array([1.0, 2.0, 3.0, 4.0, 5.0], dtype=np.float32),
        geometry=np.array([[-1.0, 0.5, 0.1, 30.0, 0.001], [-1.0, 0.25, 0.1, 20.0, 0.0]]),
        frames=np.array(["laser", "laser"]),
    )
    none = {"closures_i": np.zeros(0, dtype=int), "closures_j": np.zeros(0, dtype=int)}
    none |= {"closures_z": np.zeros((0, 3)), "closures_covariance": np.zeros((0, 3, 3)), "weights": np.zeros(0)}
    edge = {"odometry_i": np.array([0]), "odometry_j": np.array([1])}
    edge |= {"odometry_z": np.array([[1.0, 0.0, 0.5]]), "odometry_covariance": 0.01 * np.eye(3)[None]}
    graph = npz(poses=np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5]]), **edge, **none)
    head = {
        "format": "longreach map",
        "version": 1,
        "sha256": {
            "keyframes.npz": hashlib.sha256(keyframes).hexdigest(),
            "graph.npz": hashlib.sha256(graph).hexdigest(),
        },
        "sessions": [{"name": "a.bag", "robot": "thing", "mounts": {"laser": MOUNT.tolist()}, "description": {"x": 1}}],
    }
    return {"map.json": json.dumps(head), "keyframes.npz": keyframes, "graph.npz": graph}


def test_a_file_of_version_1_is_read(tmp_path):
    map_ = load_map(written(tmp_path / "old.lrmap", version_1()))
    assert map_.stamps.tolist() == [1.0, 2.0]
    assert [scan.ranges.tolist() for scan in map_.scans] == [[1.0, 2.0], [3.0, 4.0, 5.0]]
    assert (map_.scans[1].angle_increment, map_.scans[1].range_max, map_.scans[0].time_increment) == (0.25, 20.0, 0.001)
    assert map_.graph.odometry.z.tolist() == [[1.0, 0.0, 0.5]]
    assert len(map_.graph.closures) == 0
    np.testing.assert_array_equal(map_.sessions[0].mounts["laser"], MOUNT)
    assert map_.sessions[0].description == {"x": 1}


def test_a_map_of_a_later_version_says_which_ones_are_read(tmp_path):
    members = version_1()
    members["map.json"] = members["map.json"].replace('"version": 1', '"version": 7')
    with pytest.raises(
        MappingError, match=r"is a map of version 7, and this longreach reads 1; use a longreach as new"
    ):
        load_map(written(tmp_path / "new.lrmap", members))


def test_a_checksum_that_does_not_fit_is_said(tmp_path):
    members = version_1()
    graph = members["graph.npz"]
    members["graph.npz"] = graph[:200] + bytes([graph[200] ^ 1]) + graph[201:]
    with pytest.raises(MappingError, match=r"is damaged: graph.npz has another checksum than when it was written"):
        load_map(written(tmp_path / "broken.lrmap", members))


@pytest.mark.parametrize("part", [1, 0.9, 0.5, 0.01])
def test_a_map_that_is_cut_short_says_so(map_, tmp_path, part):
    path = tmp_path / "map.lrmap"
    save_map(path, map_)
    data = path.read_bytes()
    path.write_bytes(data[: min(int(part * len(data)), len(data) - 1)])
    with pytest.raises(MappingError, match="cut short: its end is missing"):
        load_map(path)


def test_no_flipped_bit_is_read_as_a_map(map_, tmp_path, rng):
    path = tmp_path / "map.lrmap"
    save_map(path, map_)
    data = path.read_bytes()
    for at in rng.integers(0, len(data), 200).tolist():
        path.write_bytes(data[:at] + bytes([data[at] ^ 8]) + data[at + 1 :])
        try:
            assert_same(map_, load_map(path))  # in what a zip says twice or nobody reads, such as a member's date
        except LongreachError as error:
            assert str(path) in str(error)  # noqa: PT017


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (None, "is not there"),
        (b"", "is no map of longreach"),
        (b"P5 10 10 255", "is no map of longreach"),
    ],
)
def test_a_file_that_is_no_map_says_so(tmp_path, data, sentence):
    path = tmp_path / "map.lrmap"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(MappingError, match=sentence):
        load_map(path)


def test_another_zip_is_no_map_and_a_folder_is_none(tmp_path):
    with pytest.raises(MappingError, match="is no map of longreach"):
        load_map(written(tmp_path / "x.lrmap", {"a.txt": "a"}))
    with pytest.raises(MappingError, match="is no map of longreach"):
        load_map(written(tmp_path / "y.lrmap", {"map.json": "[1"}))
    with pytest.raises(MappingError, match="cannot be read"):
        load_map(tmp_path)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda head, _: head["sha256"].update({"graph.npz": None}), "another checksum"),
        (lambda head, _: head.pop("sessions"), "sessions is missing"),
        (lambda head, _: head.update(sessions=[]), "is of session 0, and there are 0"),
        (lambda head, members: (members.pop("graph.npz"), head["sha256"].pop("graph.npz")), "graph.npz is missing"),
        (lambda head, _: head["sessions"][0].update(mounts={}), "does not say where its laser laser sits"),
    ],
)
def test_a_map_that_lacks_something_is_damaged_and_says_what(tmp_path, change, sentence):
    members = version_1()
    head = json.loads(members["map.json"])
    change(head, members)
    members["map.json"] = json.dumps(head)
    with pytest.raises(MappingError, match=sentence):
        load_map(written(tmp_path / "map.lrmap", members))


def test_a_map_that_cannot_be_written_leaves_the_one_before(map_, tmp_path, monkeypatch):
    path = tmp_path / "map.lrmap"
    save_map(path, map_)
    before = path.read_bytes()

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(zipfile.ZipFile, "writestr", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save_map(path, map_)
    assert [p.name for p in tmp_path.iterdir()] == ["map.lrmap"]
    assert path.read_bytes() == before


def test_parts_of_a_map_that_do_not_fit_together_are_refused(map_):
    def changed(**changes):
        names = ("graph", "weights", "scans", "twists", "session", "sessions")
        return Map(**{name: getattr(map_, name) for name in names} | changes)

    for changes, sentence in (
        ({"scans": map_.scans[1:]}, "60 keyframes has 59 scans"),
        ({"weights": map_.weights[1:]}, "shape of a map's weights"),
        ({"session": map_.session - 1}, "is of session -1, and there are 2"),
        ({"sessions": map_.sessions[::-1]}, "does not say where its laser laser sits"),
    ):
        with pytest.raises(MappingError, match=sentence):
            changed(**changes)
