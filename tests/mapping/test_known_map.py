"""An occupancy grid to localise in: what a laser would see in it, how sure that is, and what is no map."""

from dataclasses import replace

import numpy as np
import pytest
from room_maps import map_along, rows_along, walk
from room_scans import NOWHERE, scan_at

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping import _occupancy_kernels, global_start, map_localizer
from longreach.mapping.known_map import drawn, features_of
from longreach.mapping.occupancy import Occupancy, render
from longreach.odometry.scan_geometry import scan_geometry

SIZE = 0.05
WIDE = np.diag([0.2**2, 0.2**2, 0.1**2])


@pytest.fixture(scope="module")
def grid():
    return render(map_along(walk(), np.random.default_rng(1)), SIZE)


@pytest.fixture(scope="module")
def known(grid):
    return drawn(grid)


def turned(grid, motion):
    """The same grid, with its corner elsewhere."""
    return Occupancy(grid.probability, grid.known, grid.resolution, se2.compose(motion, grid.origin))


def test_the_base_is_held_in_a_grid_to_a_part_of_its_cells_and_the_covariance_knows_it():
    nees, poses = [], walk(step=0.05)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        made = map_along(walk(), rng)
        motion = np.array([*rng.uniform(-1.0, 1.0, 2), rng.uniform(-np.pi, np.pi)])  # walls lie in cells otherwise
        graph = made.graph
        moved = replace(graph, poses=se2.compose(np.broadcast_to(motion, graph.poses.shape), graph.poses))
        scans, rows = rows_along(poses, rng)
        at = [se2.compose(motion, pose) for pose in poses]
        start = se2.compose(at[0], np.array([0.08, -0.06, 0.03]))
        state = map_localizer.init(drawn(render(replace(made, graph=moved), SIZE)), NOWHERE, start, WIDE)
        _, given, corrections = map_localizer.step(state, scans, rows)
        xi = np.array([se2.difference(row.pose, pose) for row, pose in zip(given, at, strict=True)])[10:]
        P = np.array([row.covariance for row in given])[10:]
        nees.append(np.mean(np.einsum("ki,kij,kj->k", xi, np.linalg.inv(P), xi)))
        assert np.sqrt(np.mean(np.sum(xi[:, :2] ** 2, axis=1))) < 0.5 * SIZE
        sigmas = np.sqrt(P[:, 0, 0])
        assert SIZE / np.sqrt(24.0) < sigmas.min() < sigmas.max() < 0.5 * SIZE
        assert np.mean([c.status == "used" for c in corrections]) > 0.9
    assert np.mean(nees) < 4.5  # walls along the grid are the worst case


def test_a_grid_whose_origin_is_turned_is_the_same_map_elsewhere(grid, rng):
    motion = np.array([3.0, -2.0, 0.7])
    scan = scan_at([0.3, -0.2, 2.0], rng=rng)
    features = features_of(scan, scan_geometry(scan, NOWHERE, 5), np.zeros(3))
    found = global_start.search(drawn(turned(grid, motion)), features)
    off = se2.difference(found[0].pose, se2.compose(motion, np.array([0.3, -0.2, 2.0])))
    assert found[0].weight > 0.9
    assert np.hypot(*off[:2]) < SIZE


def test_beams_end_in_the_middle_of_the_first_occupied_cell_and_not_far_behind_what_is_unknown():
    occupied, free = np.zeros((1, 12), bool), np.ones((1, 12), bool)
    occupied[0, 9] = True
    ranges = np.empty((1, 2))
    for unknown, seen in ((0, True), (2, True), (3, False)):
        free[:] = True
        free[0, 9 - unknown :] = False
        _occupancy_kernels.cast(
            np.array([[1.5, 0.5]]), np.array([[1.0, 0.0], [-1.0, 0.0]]), occupied, free, 20.0, ranges
        )
        assert ranges[0, 0] == (8.0 if seen else np.inf)
        assert ranges[0, 1] == np.inf


@pytest.mark.parametrize("value", [0.0, 1.0, 0.5])
def test_a_grid_that_shows_nothing_is_refused(value):
    nothing = Occupancy(np.full((60, 60), value), np.full((60, 60), value != 0.5), SIZE, np.zeros(3))
    with pytest.raises(MappingError, match="The map is empty"):
        drawn(nothing)


def test_a_start_outside_a_grid_says_where_the_map_is(known):
    with pytest.raises(MappingError, match="which goes from"):
        map_localizer.init(known, NOWHERE, np.array([60.0, 0.0, 0.0]), WIDE)
