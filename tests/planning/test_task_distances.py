"""Distances of segments from obstacles, against sampling and by hand."""

import numpy as np
import pytest
from scipy.optimize import minimize

from longreach.geometry import se3
from longreach.planning.obstacles import Box, Capsule, Disc, base_distance, segment_distance

BOX = Box(np.eye(4), np.array([1.0, 2.0, 0.5]))


def nearest(a, b, gap):
    """The least of `gap` over points of the segment ab, by many starts of scipy."""
    best = min((gap(a + s * (b - a)), s) for s in np.linspace(0, 1, 400))
    found = minimize(lambda s: gap(a + s[0] * (b - a)), [best[1]], bounds=[(0, 1)], tol=1e-14)
    return min(best[0], float(found.fun))


def test_the_distance_to_a_capsule_is_the_least_over_both_segments(rng):
    for _ in range(20):
        a, b, c, d = rng.normal(size=(4, 3))

        def to_segment(x, c=c, d=d):
            t = np.clip((x - c) @ (d - c) / ((d - c) @ (d - c)), 0, 1)
            return float(np.linalg.norm(x - c - t * (d - c)))

        distance, near, normal = segment_distance(a, b, Capsule(c, d, 0.1))
        assert distance == pytest.approx(nearest(a, b, to_segment) - 0.1, abs=1e-6)
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        assert to_segment(near) == pytest.approx(distance + 0.1, abs=1e-9)


def test_the_distance_to_a_box_is_the_least_over_the_segment(rng):
    for _ in range(20):
        pose = se3.exp(rng.normal(size=6))
        box = Box(pose, BOX.size)
        a, b = 2.5 * rng.normal(size=(2, 3))

        def to_box(x, pose=pose):
            local = pose[:3, :3].T @ (x - pose[:3, 3])
            return float(np.linalg.norm(local - np.clip(local, -0.5 * BOX.size, 0.5 * BOX.size)))

        distance, _, _ = segment_distance(a, b, box)
        if distance > 0:
            assert distance == pytest.approx(nearest(a, b, to_box), abs=1e-6)
        else:
            assert nearest(a, b, to_box) < 1e-6


@pytest.mark.parametrize(
    ("a", "b", "other", "distance"),
    [
        ([0, 0, 1], [1, 0, 1], Capsule(np.zeros(3), np.array([1.0, 0, 0]), 0.2), 0.8),  # parallel
        ([0, 0, 1], [0, 0, 1], Capsule(np.zeros(3), np.zeros(3), 0.2), 0.8),  # two balls
        ([3, 0, 1], [3, 0, 1], Capsule(np.zeros(3), np.array([1.0, 0, 0]), 0.0), np.sqrt(5)),
        ([-1, 0, 0], [1, 0, 0], Capsule(np.array([0, -1.0, 0]), np.array([0, 1.0, 0]), 0.1), -0.1),  # crossing
        ([2, 0, 5], [2, 0, 9], Disc(np.zeros(2), 0.5), 1.5),
        ([0.5, 0, 1], [0.5, 0, 2], BOX, 0.75),
        ([0.4, 0, 0], [0.4, 0, 0], BOX, -0.1),  # inside, the near face is 0.1 away
        ([-5, 0, 0.2], [5, 0, 0.2], BOX, -0.05),  # through and through: up is the shortest way out
    ],
)
def test_distances_known_by_hand(a, b, other, distance):
    found, _, normal = segment_distance(np.array(a, dtype=float), np.array(b, dtype=float), other)
    assert found == pytest.approx(distance, abs=1e-12)
    assert np.linalg.norm(normal) == pytest.approx(1.0)


def test_a_box_is_left_along_the_floor_by_a_base_inside_it():
    flat = Box(np.eye(4), np.array([2.0, 1.0, 0.01]))
    distance, gradient = base_distance(np.array([0.2, 0.3]), flat)
    assert distance == pytest.approx(-0.2)
    np.testing.assert_allclose(gradient, [0.0, 1.0], atol=1e-12)
