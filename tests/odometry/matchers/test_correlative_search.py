"""The correlative search: where in a window a scan agrees best with the likelihood field of a map."""

import numpy as np
import pytest
from room_scans import features_of, map_of, scan_at

from longreach.geometry import se2
from longreach.odometry.matchers import _correlative_kernels
from longreach.sim.room import moved, polygon

HERE = np.array([-1.0, -0.5, 0.2])


def search(scan, to, guess, sigma, window=3.0):
    features, best = features_of(scan), np.empty(3)
    agreement = _correlative_kernels.search(
        features.values,
        features.count,
        np.array(guess),
        np.array(sigma),
        window,
        to.surfaces.origin,
        *to.field,
        best,
    )
    return best, agreement


@pytest.mark.parametrize("offset", [(0.3, -0.2, 0.25), (-0.45, 0.3, -0.3), (0.0, 0.0, 0.0), (0.6, 0.6, 0.0)], ids=str)
def test_an_offset_in_a_room_is_found_to_a_cell(offset, rng):
    pose = se2.compose(HERE, np.array(offset))
    best, agreement = search(scan_at(pose, rng=rng), map_of([HERE], rng=rng), HERE, (0.25, 0.25, 0.15))
    assert np.abs(se2.difference(best, pose)).max() < 0.06
    assert 0.4 < agreement <= 1.0


def test_a_map_of_many_keyframes_finds_what_one_does(rng):
    poses = [HERE + np.array([0.3 * i, 0.0, 0.1 * i]) for i in range(5)]
    pose = HERE + np.array([0.9, 0.3, -0.2])
    best, _ = search(scan_at(pose, rng=rng), map_of(poses, rng=rng), poses[2], (0.25, 0.25, 0.2))
    assert np.abs(se2.difference(best, pose)).max() < 0.06


def test_without_any_agreement_the_prior_is_the_best_there_is(rng):
    best, agreement = search(scan_at(HERE, rng=rng), map_of([HERE]), (45.0, 0.0, 0.3), (0.1, 0.1, 0.1))
    np.testing.assert_allclose(best, (45.0, 0.0, 0.3), atol=0.06)
    assert agreement < 0.05


def test_a_pose_at_which_beams_pass_through_walls_loses_against_the_true_one():
    """A closet of twice the size stands beside two of which it has the outline; the beams tell them apart."""
    whole = polygon([(0.0, 0.0), (2.0, 0.0), (2.0, 1.2), (0.0, 1.2)])
    between = np.array([[1.0, 0.0, 1.0, 1.2]])
    both = np.vstack([whole, between, moved(whole, 2.3, 0.0)])
    truth, other = np.array([2.8, 0.55, 0.1]), np.array([0.5, 0.55, 0.1])
    scan, guess = scan_at(truth, walls=both), (other + truth) / 2 - [0.2, 0.0, 0.0]  # a little nearer to the other
    poses = [other, other + np.array([1.0, 0.0, 0.0]), truth, truth + np.array([1.0, 0.0, 0.0])]
    open_plan = np.vstack([whole, moved(whole, 2.3, 0.0)])
    found, _ = search(scan, map_of(poses, walls=both), guess, (0.6, 0.05, 0.05))
    np.testing.assert_allclose(found, truth, atol=0.06)
    found, _ = search(scan, map_of(poses, walls=open_plan), guess, (0.6, 0.05, 0.05))
    np.testing.assert_allclose(found, other, atol=0.06)


@pytest.mark.parametrize("shift", [0.0, 0.05, 0.4, 0.8])
def test_an_offset_is_found_wherever_the_borders_of_blocks_lie(shift):
    """Blocks are 1.6 m wide: without a shift all walls stand on their borders."""
    walls = moved(polygon([(-1.6, -3.2), (3.2, -3.2), (3.2, 1.6), (1.6, 1.6), (1.6, 3.2), (-1.6, 3.2)]), shift, shift)
    start = np.array([0.5 + shift, -0.4 + shift, 0.0])
    pose = start + np.array([0.25, 0.25, 0.1])
    best, agreement = search(scan_at(pose, walls=walls), map_of([start], walls=walls), start, (0.2, 0.2, 0.1))
    assert np.abs(best - pose).max() < 0.06
    assert agreement > 0.6


def test_what_is_best_only_at_the_edge_of_the_window_is_none(rng):
    guess = HERE + np.array([0.0, 0.0, -0.42])
    to, scan = map_of([HERE], rng=rng), scan_at(HERE, rng=rng)
    best = guess.copy()
    features = features_of(scan)
    _correlative_kernels.search(
        features.values, features.count, guess, np.array([0.03, 0.03, 0.12]), 3.0, to.surfaces.origin, *to.field, best
    )
    assert abs(best[2] - guess[2]) < 0.3  # three deviations are 0.36, where the scan agrees best
