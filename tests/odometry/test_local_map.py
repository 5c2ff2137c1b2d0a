"""The local map: keyframes' surfaces merged into cells, and found again."""

from dataclasses import replace

import numpy as np
import pytest
from room_scans import along, features_of, map_of, scan_at, scans_along

from longreach.geometry import se2
from longreach.measurement import LaserScan
from longreach.odometry import _local_map_kernels, local_map
from longreach.odometry.local_map import Keyframe
from longreach.sim.room import box

CELL, FINE, COARSE = _local_map_kernels.CELL, _local_map_kernels.FINE, _local_map_kernels.COARSE
POSES = along((0.3, 0.05, 0.2), 4)


def keyframes_along(poses, rng=None, **kind):
    return [
        local_map.keyframe(features_of(scan), pose)
        for scan, pose in zip(scans_along(poses, rng=rng, **kind), poses, strict=True)
    ]


def moved(keyframe, by):
    return replace(keyframe, pose=keyframe.pose + np.array([*by, 0.0]))


def normals_at(found, x, y, within=0.05):
    near = np.hypot(found.surfaces.elements[:, 0] - x, found.surfaces.elements[:, 1] - y) < within
    return found.surfaces.elements[near, 2:4]


@pytest.mark.parametrize("cells", [(1, 0), (-7, 3), (16, -32), (1234, -777)])
def test_a_map_moves_with_its_keyframes_by_whole_cells_and_does_not_change(cells, rng):
    keyframes, by = keyframes_along(POSES, rng), CELL * np.array(cells)
    a, b = local_map.merged(keyframes), local_map.merged([moved(k, by) for k in keyframes])
    shift = np.array([*by, 0.0, 0.0, 0.0, 0.0])
    assert len(a.surfaces.elements) == len(b.surfaces.elements)
    np.testing.assert_allclose(b.surfaces.elements, a.surfaces.elements + shift, atol=1e-9)
    np.testing.assert_allclose(b.poses[:, :2], a.poses[:, :2] + by, atol=1e-12)


def test_elements_lie_in_the_cell_that_holds_them(rng):
    found, side = local_map.merged(keyframes_along(POSES, rng)), _local_map_kernels.SIDE
    seen = 0
    for b in range(len(found.surfaces.cells)):
        (at,) = np.argwhere(found.surfaces.blocks == b)
        for i, k, layer in np.argwhere(found.surfaces.cells[b] >= 0):
            low = found.surfaces.origin + CELL * (side * at + [i, k])
            middle = found.surfaces.elements[found.surfaces.cells[b, i, k, layer], :2]
            assert (middle >= low - 1e-9).all()
            assert (middle <= low + CELL + 1e-9).all()
            seen += 1
    assert seen == len(found.surfaces.elements)
    assert found.surfaces.blocks.max() + 1 == len(found.surfaces.cells)


def test_no_return_is_lost_or_counted_twice(rng):
    keyframes = keyframes_along(POSES[:1], rng)
    returns = np.isfinite(features_of(scan_at(POSES[0], rng=np.random.default_rng(20260101))).values[7]).sum()
    assert keyframes[0].elements[:, 4].sum() == pytest.approx(returns, rel=1e-9)
    assert local_map.merged(keyframes).surfaces.elements[:, 4].sum() <= returns + 1e-9


def test_a_sparse_scan_in_a_large_hall_leaves_the_surface_of_its_last_beams_too():
    hall = box(0.0, 0.0, 20.0, 20.0, 0.0)
    features = features_of(scan_at((0.0, 0.0, 0.0), walls=hall, beams=60))
    normals = np.isfinite(features.values[7, : features.count])
    made = local_map.keyframe(features, np.zeros(3)).elements
    assert made[:, 4].sum() == pytest.approx(np.count_nonzero(normals))
    for beam in np.flatnonzero(normals):
        assert np.hypot(*(made[:, :2] - features.values[:2, beam]).T).min() < CELL


def test_a_thin_wall_seen_from_both_sides_keeps_two_surfaces_within_one_row_of_cells(rng):
    wall = box(2.05, 0.0, 0.04, 3.0, 0.0)
    found = map_of([(0.5, 0.0, 0.0), (3.5, 0.0, np.pi), (0.7, 0.3, 0.1)], walls=wall, rng=rng)
    for y in (-0.6, 0.05, 0.45):
        normals = normals_at(found, 2.05, y, 0.1)
        assert (np.abs(normals[:, 0]) > 0.9).all()
        assert normals[:, 0].min() < 0.0 < normals[:, 0].max()
    left, right = (
        found.surfaces.elements[found.surfaces.elements[:, 2] < -0.9],
        found.surfaces.elements[found.surfaces.elements[:, 2] > 0.9],
    )
    np.testing.assert_allclose(left[:, 0], 2.03, atol=0.03)
    np.testing.assert_allclose(right[:, 0], 2.07, atol=0.03)
    assert abs(np.mean(right[:, 0]) - np.mean(left[:, 0]) - 0.04) < 0.01


def test_whatever_surfaces_lie_in_a_cell_all_elements_have_unit_normals(rng):
    keyframes = []
    for _ in range(30):
        angle = rng.uniform(-np.pi, np.pi, 200)
        rows = [rng.uniform(0, 0.3, 200), rng.uniform(0, 0.3, 200), np.cos(angle), np.sin(angle)]
        keyframes.append(Keyframe(np.zeros(3), np.stack([*rows, np.ones(200), np.ones(200)], axis=1), 0.01))
        opposite = keyframes[-1].elements * [1, 1, -1, -1, 1, 1] + [0.04, 0, 0, 0, 0, 0]
        keyframes.append(Keyframe(np.zeros(3), opposite, 0.01))
    found = local_map.merged(keyframes)
    assert np.isfinite(found.surfaces.elements).all()
    np.testing.assert_allclose(np.hypot(*found.surfaces.elements[:, 2:4].T), 1.0, atol=1e-12)
    assert len(found.surfaces.elements) <= 2 * 25


def test_features_whose_normals_turn_about_from_beam_to_beam_make_unit_normals(rng):
    for _ in range(20):
        features = features_of(scan_at((0.0, 0.0, 0.0), walls=box(2.0, 0.0, 0.5, 0.5, 0.3), beams=721))
        values, m = features.values.copy(), features.count
        angle = rng.uniform(-np.pi, np.pi, m)
        values[5, :m], values[6, :m], values[7, :m] = np.cos(angle), np.sin(angle), 1.0
        made = local_map.keyframe(replace(features, values=values), np.zeros(3)).elements
        np.testing.assert_allclose(np.hypot(made[:, 2], made[:, 3]), 1.0, atol=1e-12)


def test_a_map_has_a_bounded_number_of_keyframes_none_of_them_far_away():
    one = keyframes_along(POSES[:1])[0]
    drive = [replace(one, pose=np.array([0.25 * i, 0.0, 0.0])) for i in range(200)]
    found = local_map.merged(drive[:1])
    for keyframe in drive[1:]:
        found = local_map.merged((*found.keyframes, keyframe))
        assert found.keyframes[-1] is keyframe
        assert len(found.keyframes) == len(found.poses) <= 40
        assert np.hypot(*(found.poses[:, :2] - keyframe.pose[:2]).T).max() <= 12.0
    assert len(found.keyframes) == 40
    far = local_map.merged([drive[0], replace(one, pose=np.array([12.1, 0.0, 0.0]))])
    assert len(far.keyframes) == 1


def test_what_lies_outside_of_the_map_is_left_out():
    (one,) = keyframes_along(POSES[:1])
    there = one.elements + np.array([200.0, -200.0, 0.0, 0.0, 0.0, 0.0])
    found = local_map.merged([one, replace(one, elements=there)])
    np.testing.assert_array_equal(found.surfaces.elements, local_map.merged([one]).surfaces.elements)


def test_merging_changes_no_keyframe(rng):
    keyframes = keyframes_along(POSES, rng)
    before = [k.elements.copy() for k in keyframes]
    a, b = local_map.merged(keyframes), local_map.merged(keyframes)
    np.testing.assert_array_equal(a.surfaces.elements, b.surfaces.elements)
    for keyframe, elements in zip(keyframes, before, strict=True):
        np.testing.assert_array_equal(keyframe.elements, elements)


def test_a_scan_of_clutter_alone_makes_a_map_without_surfaces(rng):
    clutter = LaserScan(0.0, rng.uniform(0.5, 20.0, 180), -np.pi / 2, np.pi / 180)
    features = features_of(clutter)
    values = features.values.copy()
    values[5:7], values[7] = 0.0, np.inf
    found = local_map.merged([local_map.keyframe(replace(features, values=values), np.zeros(3))])
    assert len(found.surfaces.elements) == 0
    _, field, pooled = found.field
    assert not field.any()
    assert not pooled.any()


def fine_cells(points, found):
    """Where points (n, 2) of a map are in its likelihood field."""
    return tuple((np.floor((points - found.surfaces.origin) / (CELL / FINE)).astype(int) - found.field[0]).T)


def test_the_likelihood_is_highest_at_the_surfaces_and_nothing_away_from_them(rng):
    found = local_map.merged(keyframes_along(POSES, rng))
    _, field, _ = found.field
    assert field[fine_cells(found.surfaces.elements[:, :2], found)].min() > 255 * 0.8
    assert field.mean() < 60


def test_a_surface_at_the_border_of_a_block_reaches_into_the_next():
    border = _local_map_kernels.SIDE * CELL
    found = map_of([(0.2, 0.3, 0.0)], walls=np.array([[border + 1e-3, -3.0, border + 1e-3, 3.0]]))
    _, field, pooled = found.field
    i, k = np.round((np.array([0.0, 0.0]) - found.surfaces.origin) / border).astype(int)
    assert found.surfaces.blocks[i, k] < 0 <= found.surfaces.blocks[i + 1, k]
    (x,), (y,) = fine_cells(np.array([[border - 1e-3, 0.3]]), found)
    assert field[x, y - 10 : y + 10].max() > 100
    assert pooled[x // COARSE, y // COARSE - 2 : y // COARSE + 2].max() > 200


def test_the_likelihood_field_ends_in_zeros(rng):
    for part in local_map.merged(keyframes_along(POSES, rng)).field[1:]:
        assert part.any()
        assert not any(edge.any() for edge in (part[0], part[-1], part[:, 0], part[:, -1]))


def test_the_coarse_field_bounds_the_fine_one_in_and_next_to_its_cells(rng):
    found = local_map.merged(keyframes_along(POSES, rng))
    _, field, pooled = found.field
    largest = field.reshape(len(pooled), COARSE, pooled.shape[1], COARSE)
    assert (pooled >= largest.max(axis=(1, 3))).all()
    assert (pooled[1:] >= largest[:-1, -1:].max(axis=(1, 3))).all()
    assert (pooled[:-1] >= largest[1:, :1].max(axis=(1, 3))).all()
    assert (pooled == 0).any()


def test_where_a_keyframe_turns_the_map_turns(rng):
    (one,) = keyframes_along(POSES[:1], rng)
    turned = local_map.merged([replace(one, pose=np.array([0.0, 0.0, np.pi / 2]))])
    still = local_map.merged([replace(one, pose=np.zeros(3))])
    for element in still.surfaces.elements[::20]:
        there = se2.transform(np.array([0.0, 0.0, np.pi / 2]), element[None, :2])[0]
        assert np.hypot(*(turned.surfaces.elements[:, :2] - there).T).min() < CELL
