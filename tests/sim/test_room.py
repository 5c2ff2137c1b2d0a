"""Ray casting against a second way to do it, and the room it is done in."""

import numpy as np
import pytest

from longreach.sim.room import FREE, box, cast, polygon, polygonal_room


def march(segments, pose, angle):
    """Distance to the nearest wall by cutting: the ray as a line, each wall's ends on which side of it."""
    direction = np.array([np.cos(pose[2] + angle), np.sin(pose[2] + angle)])
    normal = np.array([-direction[1], direction[0]])
    distances = []
    for start, end in segments.reshape(-1, 2, 2) - pose[:2]:
        a, b = start @ normal, end @ normal
        if a * b > 0 or a == b:
            continue
        crossing = start + (end - start) * a / (a - b)
        if crossing @ direction > 0:
            distances.append(crossing @ direction)
    return min(distances, default=np.inf)


def test_rays_agree_with_an_independent_cast(rng):
    room = polygonal_room()
    poses = np.column_stack(
        [rng.uniform(-FREE[0], FREE[0], 30), rng.uniform(-FREE[1], FREE[1], 30), rng.normal(size=30)]
    )
    angles = np.linspace(-2.3, 2.3, 37)
    expected = [[march(room, pose, angle) for angle in angles] for pose in poses]
    np.testing.assert_allclose(cast(room, poses, angles), expected, rtol=1e-12)


def test_a_ray_into_a_corner_or_along_a_wall_does_not_slip_through():
    square = box(0.0, 0.0, 2.0, 2.0, 0.0)
    ranges = cast(square, np.zeros((1, 3)), np.pi / 4 * np.arange(8))[0]
    np.testing.assert_allclose(ranges, np.where(np.arange(8) % 2 == 1, np.sqrt(2), 1.0))
    assert cast(square, np.array([[0.0, 1.0, 0.0]]), np.zeros(1))[0, 0] == pytest.approx(1.0)


def test_where_nothing_stands_the_range_is_infinite():
    assert np.isinf(cast(polygon([(1.0, -1.0), (1.0, 1.0), (2.0, 0.0)]), np.zeros((1, 3)), np.array([np.pi]))).all()


def test_the_free_part_of_the_room_keeps_the_walls_away_and_is_closed_in():
    x, y = np.meshgrid(np.linspace(-FREE[0], FREE[0], 9), np.linspace(-FREE[1], FREE[1], 9))
    poses = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    ranges = cast(polygonal_room(), poses, np.linspace(0.0, 2 * np.pi, 720))
    assert ranges.min() > 0.8
    assert np.isfinite(ranges).all()
    assert ranges.max() > 6.0
