"""Grids against geometry that is known, and files against a reader that follows map_server's rules on its own."""

import numpy as np
import pytest
import yaml

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping import _occupancy_kernels as kernels
from longreach.mapping.map_file import Map, Session
from longreach.mapping.occupancy import Occupancy, beams, read_map_server, render, write_map_server
from longreach.mapping.pose_graph import PoseGraph, no_edges
from longreach.measurement import LaserScan

WIDE, HIGH = 6.0, 4.0  # of the room around the origin [m]


def room_scan(pose, beams=720, **geometry):
    """What a laser at a pose in the room sees: where each beam meets the nearest wall."""
    angles = -np.pi + 2 * np.pi / beams * np.arange(beams)
    d = np.column_stack([np.cos(angles + pose[2]), np.sin(angles + pose[2])])
    d = np.where(d == 0, 1e-300, d)
    to_wall = (np.sign(d) * np.array([WIDE / 2, HIGH / 2]) - pose[:2]) / d
    return LaserScan(0.0, to_wall.min(axis=1), -np.pi, 2 * np.pi / beams, 0.05, 10.0, **geometry)


def of_scans(poses, scans, mount=None):
    session = Session("room", "none", {"laser": np.eye(4) if mount is None else mount})
    n = len(poses)
    graph = PoseGraph(np.array(poses), no_edges(), no_edges())
    return Map(graph, np.zeros(0), tuple(scans), np.zeros((n, 3)), np.zeros(n, dtype=int), (session,))


def centres(grid):
    """x and y of the cells' centres [m]."""
    rows, columns = np.indices(grid.known.shape)
    return grid.origin[0] + (columns + 0.5) * grid.resolution, grid.origin[1] + (rows + 0.5) * grid.resolution


@pytest.mark.parametrize("resolution", [0.02, 0.05, 0.13])
def test_a_room_is_free_inside_occupied_at_its_walls_and_unknown_outside(resolution):
    poses = [np.array([0.51, -0.32, 0.4]), np.array([-1.52, 1.03, -2.0])]
    grid = render(of_scans(poses, [room_scan(pose, 2000) for pose in poses]), resolution)
    x, y = centres(grid)
    inside = np.maximum(np.abs(x) - WIDE / 2, np.abs(y) - HIGH / 2)  # below 0 inside, by the distance to the wall
    assert np.all(grid.free[inside < -1.5 * resolution])
    assert not np.any(grid.known[inside > 1.5 * resolution])
    assert np.all(np.abs(inside[grid.occupied]) <= 1.5 * resolution)
    on_wall = (np.abs(x - WIDE / 2) <= 0.5 * resolution) & (np.abs(y) < 1.0)
    assert np.all(
        grid.occupied[on_wall].any() and grid.occupied[:, on_wall.any(axis=0)][np.abs(y[:, 0]) < 1.0].any(axis=1)
    )


def test_a_beam_passes_through_the_cells_that_lie_on_its_way(rng):
    starts, ends = rng.uniform(-3, 23, (2, 60, 2))
    for start, end in zip(starts, ends, strict=True):
        hits, passes = np.zeros((20, 20), dtype=np.int32), np.zeros((20, 20), dtype=np.int32)
        kernels.trace(start[None], end[None], np.array([True]), hits, passes)
        points = start + np.linspace(0, 1, 20001)[:, None] * (end - start)
        cells = {(r, c) for c, r in np.floor(points).astype(int).tolist() if 0 <= r < 20 and 0 <= c < 20}
        found = {tuple(cell) for cell in np.argwhere(hits + passes).tolist()}
        assert cells <= found  # a corner that is cut may be too short for the sampled points
        assert len(found - cells) <= 1
        assert np.all(hits + passes <= 1)
        c, r = np.floor(end).astype(int)
        assert hits.sum() == (1 if 0 <= r < 20 and 0 <= c < 20 else 0)


@pytest.mark.parametrize("end", [(2.5, 2.5), (2.5, 9.5), (9.5, 2.5), (2.5, 0.5), (0.5, 2.5), (6.5, 6.5)])
def test_beams_along_axes_and_diagonals_take_each_cell_once(end):
    hits, passes = np.zeros((12, 12), dtype=np.int32), np.zeros((12, 12), dtype=np.int32)
    kernels.trace(np.array([[2.5, 2.5]]), np.array([end]), np.array([False]), hits, passes)
    assert hits.sum() == 0
    assert passes.sum() == 1 + abs(int(end[0]) - 2) + abs(int(end[1]) - 2)


def test_a_rigid_motion_of_the_map_moves_the_beams_with_it(rng):
    scan = room_scan(np.zeros(3), time_increment=1e-4)
    pose, twist, T = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)
    mount = np.eye(4)
    mount[:2, 3] = 0.3, -0.1
    starts, ends, hit = beams(scan, mount, pose, twist)
    moved = beams(scan, mount, se2.compose(T, pose), twist)
    np.testing.assert_allclose(moved[0], se2.transform(T, starts), atol=1e-12)
    np.testing.assert_allclose(moved[1], se2.transform(T, ends), atol=1e-12)
    assert np.all(hit)


def test_the_motion_during_a_sweep_is_taken_out_of_the_beams():
    twist, increment, n = np.array([1.0, 0.5, 2.0]), 1e-4, 360
    late = increment * np.arange(n)
    at = se2.exp(late[:, None] * twist)
    seen = [room_scan(pose, n).ranges[k] for k, pose in enumerate(at)]
    scan = LaserScan(0.0, np.array(seen), -np.pi, 2 * np.pi / n, 0.05, 10.0, increment)
    _, ends, _ = beams(scan, np.eye(4), np.zeros(3), twist)
    wall = np.maximum(np.abs(ends[:, 0]) - WIDE / 2, np.abs(ends[:, 1]) - HIGH / 2)
    np.testing.assert_allclose(wall, 0.0, atol=1e-9)
    _, bent, _ = beams(scan, np.eye(4), np.zeros(3), np.zeros(3))
    assert np.abs(np.maximum(np.abs(bent[:, 0]) - WIDE / 2, np.abs(bent[:, 1]) - HIGH / 2)).max() > 0.01


def test_a_laser_upside_down_draws_the_same_room():
    pose = np.array([0.5, 0.3, 0.2])
    scan = room_scan(pose)
    turned = LaserScan(0.0, scan.ranges, np.pi, -scan.angle_increment, 0.05, 10.0)
    _, ends, _ = beams(scan, np.eye(4), pose, np.zeros(3))
    _, same, _ = beams(turned, np.diag([1.0, -1.0, -1.0, 1.0]), pose, np.zeros(3))
    np.testing.assert_allclose(same, ends, atol=1e-12)


def test_beams_beyond_the_range_are_free_as_far_as_the_farthest_return_and_others_say_nothing():
    scan = LaserScan(0.0, np.array([4.0, np.inf, 31.0, np.nan, 0.0, 0.01]), 0.0, 0.5, 0.05, 30.0)
    _, ends, hit = beams(scan, np.eye(4), np.zeros(3), np.zeros(3))
    assert hit.tolist() == [True, False, False]
    np.testing.assert_allclose(np.linalg.norm(ends, axis=1), 4.0)


def test_a_map_without_returns_or_with_too_fine_a_resolution_is_refused():
    blind = LaserScan(0.0, np.full(8, np.inf), 0.0, 0.1, 0.0, 10.0)
    with pytest.raises(MappingError, match="No beam of the map's scans came back"):
        render(of_scans([np.zeros(3)], [blind]))
    map_ = of_scans([np.zeros(3)], [room_scan(np.zeros(3))])
    with pytest.raises(MappingError, match="too large; take a coarser resolution"):
        render(map_, 1e-5)
    for resolution in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(MappingError, match="is no size of a cell"):
            render(map_, resolution)


def map_server(yaml_path):
    """data (rows, columns), origin and resolution of the OccupancyGrid, by the rules of map_server's image_loader."""
    keys = yaml.safe_load(yaml_path.read_text())
    tokens, raster = (yaml_path.parent / keys["image"]).read_bytes(), None
    words = []
    while len(words) < 4:  # the header: words after words, comments to the end of their line
        tokens = tokens.lstrip()
        if tokens.startswith(b"#"):
            tokens = tokens.split(b"\n", 1)[1]
            continue
        word = tokens.split(None, 1)[0]
        words.append(word)
        tokens = tokens[len(word) :]
    columns, rows, top = (int(word) for word in words[1:])
    if words[0] == b"P5":
        raster = np.frombuffer(tokens[1:], dtype=np.uint8)
    else:
        raster = np.array([int(v) for line in tokens.splitlines() for v in line.split(b"#")[0].split()])
    image = raster.reshape(rows, columns) * 255.0 / top
    data = np.empty((rows, columns), dtype=int)
    for j in range(rows):
        for i in range(columns):
            colour = image[j, i]
            if keys["negate"]:
                colour = 255 - colour
            at = (rows - j - 1, i)
            if keys.get("mode") == "raw":
                data[at] = colour if colour <= 100 else -1
                continue
            occ = (255 - colour) / 255.0
            if occ > keys["occupied_thresh"]:
                data[at] = 100
            elif occ < keys["free_thresh"]:
                data[at] = 0
            elif keys.get("mode", "trinary") == "trinary":
                data[at] = -1
            else:
                data[at] = 1 + 98 * (occ - keys["free_thresh"]) / (keys["occupied_thresh"] - keys["free_thresh"])
    return data, keys["origin"], keys["resolution"]


def test_an_independent_reader_of_map_server_sees_the_same_map(tmp_path):
    pose = np.array([0.5, 0.3, 0.2])
    grid = render(of_scans([pose], [room_scan(pose)]))
    write_map_server(tmp_path / "map.pgm", grid)
    data, origin, resolution = map_server(tmp_path / "map.yaml")
    np.testing.assert_array_equal(data == 100, grid.occupied)
    np.testing.assert_array_equal(data == 0, grid.free)
    np.testing.assert_array_equal(data == -1, ~grid.occupied & ~grid.free)
    assert origin == grid.origin.tolist()
    assert resolution == 0.05
    again = read_map_server(tmp_path / "map.yaml")
    np.testing.assert_array_equal(again.occupied, grid.occupied)
    np.testing.assert_array_equal(again.free, grid.free)
    np.testing.assert_array_equal(again.origin, grid.origin)


IMAGES = {
    "binary": b"P5\n# CREATOR: a tool 0.050 m/pix\n3 2\n# another\n255\n" + bytes([0, 254, 205, 100, 180, 60]),
    "text": b"P2\n# by hand\n3 2\n255\n0 254 205\n100 180 60\n",
    "other top": b"P2\n3 2\n100\n0 100 80\n40 70 20\n",
}


@pytest.mark.parametrize("image", IMAGES)
@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_maps_of_others_are_read_by_the_rules_of_map_server(tmp_path, image, negate, mode):
    (tmp_path / "floor.pgm").write_bytes(IMAGES[image])
    text = f"image: floor.pgm\nresolution: 0.1\norigin: [-3.0, 2.0, 0.5]\nnegate: {negate}\nmode: {mode}\n"
    (tmp_path / "m.yaml").write_text(text + "occupied_thresh: 0.7\nfree_thresh: 0.25\n")
    data, _, _ = map_server(tmp_path / "m.yaml")
    grid = read_map_server(tmp_path / "m.yaml")
    np.testing.assert_array_equal(grid.known, data >= 0)
    np.testing.assert_allclose(grid.probability[grid.known], data[grid.known] / 100.0, atol=0.015)
    assert grid.origin.tolist() == [-3.0, 2.0, 0.5]


def test_transparent_pixels_of_a_png_are_unknown_in_mode_scale(tmp_path):
    from PIL import Image

    pixels = np.array([[[0, 0], [127, 255], [127, 0]]], dtype=np.uint8)
    Image.fromarray(pixels, "LA").save(tmp_path / "m.png")
    (tmp_path / "m.yaml").write_text("image: m.png\nresolution: 0.1\norigin: [0, 0, 0]\nmode: scale\n")
    assert read_map_server(tmp_path / "m.yaml").known.tolist() == [[True, True, False]]


GOOD = "image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n"


@pytest.mark.parametrize(
    ("text", "image", "sentence"),
    [
        (None, b"", "m.yaml is not there"),
        ("resolution: 0.1\norigin: [0, 0, 0]\n", b"", "does not say the map's image"),
        ("a: [", b"", "is no description of a map as map_server writes it"),
        ("", b"", "is no description of a map"),
        (GOOD.replace("0.1", "wide"), b"", "is no description of a map"),
        (GOOD.replace("0.1", "0"), b"", "needs a resolution"),
        (GOOD.replace("[0, 0, 0]", "[0, 0]"), b"", "an origin"),
        (GOOD + "mode: colourful\n", b"", "has the mode 'colourful'; map_server has trinary, scale and raw"),
        (GOOD, None, "m.pgm, the image of a map, is not there"),
        (GOOD, b"no image", "m.pgm cannot be read as an image"),
        (GOOD, IMAGES["binary"][:-3], "m.pgm cannot be read as an image"),
    ],
)
def test_a_map_that_cannot_be_read_says_why(tmp_path, text, image, sentence):
    if text is not None:
        (tmp_path / "m.yaml").write_text(text)
    if image is not None:
        (tmp_path / "m.pgm").write_bytes(image)
    with pytest.raises(MappingError, match=sentence):
        read_map_server(tmp_path / "m.yaml")


def test_cells_that_are_neither_occupied_nor_free_are_unknown_to_map_server(tmp_path):
    half = Occupancy(np.array([[0.1, 0.5, 0.9, 0.9]]), np.array([[True, True, True, False]]), 0.1, np.zeros(3))
    write_map_server(tmp_path / "map.pgm", half)
    assert map_server(tmp_path / "map.yaml")[0].tolist() == [[0, -1, 100, -1]]
