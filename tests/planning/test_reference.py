"""References: what they check, the curves they are made of, and the thesis' dual trajectory."""

import os
from pathlib import Path

import numpy as np
import pytest

from longreach.errors import PlanningError
from longreach.geometry import se3, so3
from longreach.planning.profile import SpeedProfile
from longreach.planning.reference import (
    at_even_speed,
    base_poses,
    circle,
    dual_trajectory,
    length,
    sinusoid,
    slerp,
    straight_line,
    tool_poses,
    waypoint_spline,
)
from longreach.reference import Reference

U = np.linspace(0.0, 1.0, 201)
A, B = np.array([0.5, -0.2, 1.0]), np.array([2.5, 0.4, 0.7])


def reference(**changes):
    good = {"stamps": np.arange(3.0), "tool": np.tile(np.eye(4), (3, 1, 1)), "base": np.zeros((3, 3))}
    return Reference(**(good | changes))


def test_a_reference_is_read_only_and_no_one_elses():
    base = np.zeros((3, 3))
    checked = reference(base=base)
    base[:] = 7.0
    assert not np.any(checked.base)
    with pytest.raises(ValueError, match="read-only"):
        checked.tool[0, 0, 3] = 1.0
    assert len(checked) == 3
    assert reference(tool=None).tool is None


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"stamps": np.zeros(0), "tool": np.zeros((0, 4, 4)), "base": None}, "is empty"),
        ({"tool": None, "base": None}, "neither tool poses nor base poses"),
        ({"stamps": np.array([0.0, 1.0, np.nan])}, "stamps must be finite; row 2"),
        ({"stamps": np.array([0.0, 2.0, 1.0])}, "must increase"),
        ({"base": np.array([[0, 0, 0], [0, np.nan, 0], [0, 0, 0.0]])}, "base must be finite; row 1"),
        ({"tool": np.full((3, 4, 4), np.inf)}, "tool must be finite; row 0"),
        ({"tool": np.tile(np.diag([1.0, 1.0, -1.0, 1.0]), (3, 1, 1))}, "at row 0 is no rigid motion"),
        ({"tool": np.stack([np.eye(4), np.eye(4), 1.01 * np.eye(4)])}, "at row 2 is no rigid motion"),
        ({"tool": np.stack([np.eye(4), np.eye(4).T + np.eye(4, k=-3), np.eye(4)])}, "at row 1 is no rigid motion"),
    ],
)
def test_what_cannot_be_followed_is_refused(changes, sentence):
    with pytest.raises(PlanningError, match=sentence):
        reference(**changes)


def test_arrays_of_different_lengths_are_refused():
    with pytest.raises(Exception, match="base"):
        reference(base=np.zeros((2, 3)))


@pytest.mark.parametrize(
    "curve", [straight_line(A, B), sinusoid(A, B, 0.3, periods=2.0)], ids=["straight line", "sinusoid"]
)
def test_a_curve_begins_at_its_start_and_ends_at_its_end(curve):
    np.testing.assert_allclose(curve(U)[[0, -1]], [A, B], atol=1e-12)


def test_a_straight_line_is_as_long_as_its_ends_are_apart():
    assert length(straight_line(A, B)) == pytest.approx(np.linalg.norm(B - A))


def test_a_circle_keeps_its_distance_and_closes():
    normal = np.array([1.0, 1.0, 2.0])
    points = circle(A, B, normal)(U)
    np.testing.assert_allclose(np.linalg.norm(points - B, axis=1), np.linalg.norm(A - B), atol=1e-12)
    np.testing.assert_allclose((points - A) @ normal, 0.0, atol=1e-12)
    np.testing.assert_allclose(points[-1], A, atol=1e-12)
    quarter = circle(np.array([1.0, 0.0, 0.0]), np.zeros(3), angle=np.pi / 2)
    np.testing.assert_allclose(quarter(np.ones(1)), [[0.0, 1.0, 0.0]], atol=1e-15)
    assert length(quarter) == pytest.approx(np.pi / 2, rel=1e-6)


def test_a_sinusoid_swings_to_the_left_first():
    points = sinusoid(np.zeros(3), np.array([0.0, 4.0, 0.0]), 0.5)(np.array([0.25, 0.5, 0.75]))
    np.testing.assert_allclose(points, [[-0.5, 1.0, 0.0], [0.0, 2.0, 0.0], [0.5, 3.0, 0.0]], atol=1e-15)


def test_a_spline_meets_its_waypoints_and_bends_without_a_jump(rng):
    waypoints = rng.normal(size=(7, 3))
    curve = waypoint_spline(waypoints)
    chords = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    knots = np.concatenate(([0.0], np.cumsum(chords))) / chords.sum()
    np.testing.assert_allclose(curve(knots), waypoints, atol=1e-12)
    h = 1e-5
    for knot in knots[1:-1]:
        before, after = ((curve(x - h) - 2 * curve(x) + curve(x + h)) / h**2 for x in (knot - h, knot + h))
        np.testing.assert_allclose(after, before, rtol=1e-2, atol=1e-2 * np.abs(before).max())


def test_even_speed_covers_equal_distances():
    curve = at_even_speed(sinusoid(A, B, 0.5, periods=2.0))
    steps = np.linalg.norm(np.diff(curve(np.linspace(0.0, 1.0, 2001)), axis=0), axis=1)
    assert np.ptp(steps) < 1e-4 * steps.mean()
    np.testing.assert_allclose(curve(U)[[0, -1]], [A, B], atol=1e-12)


def test_slerp_turns_evenly_from_start_to_end(rng):
    R_start, R_end = so3.exp(rng.normal(size=3)), so3.exp(rng.normal(size=3))
    R = slerp(R_start, R_end)(U)
    np.testing.assert_allclose(R[[0, -1]], [R_start, R_end], atol=1e-12)
    turns = so3.difference(R[:-1], R[1:])
    np.testing.assert_allclose(turns, np.tile(turns[0], (200, 1)), atol=1e-12)


def test_tool_poses_take_their_position_and_orientation_from_each(rng):
    R = so3.exp(rng.normal(size=3))
    line = straight_line(A, B)
    T = tool_poses(line, R, U)
    np.testing.assert_array_equal(T[:, :3, 3], line(U))
    np.testing.assert_array_equal(T[:, :3, :3], np.tile(R, (201, 1, 1)))
    np.testing.assert_allclose(tool_poses(line, slerp(R, np.eye(3)), U)[-1, :3, :3], np.eye(3), atol=1e-15)
    Reference(U, tool=T)


def test_a_base_looks_along_its_path_when_asked():
    line = straight_line(A, B)
    np.testing.assert_allclose(base_poses(line, U, heading=None)[:, 2], np.arctan2(0.6, 2.0), atol=1e-9)
    np.testing.assert_array_equal(base_poses(line, U)[:, 2], 0.0)
    round_and_round = base_poses(circle(A, B, angle=4 * np.pi), U, heading=None)
    np.testing.assert_allclose(np.ptp(round_and_round[:, 2]), 4 * np.pi, atol=1e-4)


def test_curves_without_a_direction_are_refused():
    with pytest.raises(PlanningError, match="normal of a circle"):
        circle(A, B, np.zeros(3))
    with pytest.raises(PlanningError, match="side of a sinusoid"):
        sinusoid(A, A, 0.1)
    with pytest.raises(PlanningError, match="two waypoints"):
        waypoint_spline(np.stack([A, A, B]))
    with pytest.raises(PlanningError, match="stands still"):
        at_even_speed(straight_line(A, A))


def test_the_dual_trajectory_is_a_line_and_a_sinusoid_in_the_bases_own_frame(rng):
    T_start = se3.exp(rng.normal(size=6))
    base_start = np.array([1.0, -2.0, 0.7])
    dual = dual_trajectory(T_start, base_start, length=3.0, amplitude=0.4, periods=2.0, waypoints=81)
    ahead, left = np.array([np.cos(0.7), np.sin(0.7)]), np.array([-np.sin(0.7), np.cos(0.7)])
    np.testing.assert_allclose(dual.tool[-1, :2, 3] - T_start[:2, 3], 3.0 * ahead, atol=1e-12)
    np.testing.assert_allclose(dual.tool[:, 2, 3], T_start[2, 3])
    local = dual.base[:, :2] - base_start[:2]
    np.testing.assert_allclose(local @ ahead, np.linspace(0.0, 3.0, 81), atol=1e-12)
    np.testing.assert_allclose(local @ left, 0.4 * np.sin(np.linspace(0.0, 4 * np.pi, 81)), atol=1e-12)
    np.testing.assert_allclose(dual.base[:, 2], 0.7)


def test_the_dual_trajectory_is_that_of_the_problem_set():
    folder = os.environ.get("LONGREACH_BENCH")
    if not folder:
        pytest.skip("LONGREACH_BENCH does not name a folder of problem sets")
    with np.load(Path(folder) / "dual.npz") as bench:
        dual = dual_trajectory(bench["T"][0], bench["home"][:3])
        np.testing.assert_allclose(dual.tool, bench["T"], atol=1e-14)
        np.testing.assert_allclose(dual.base, bench["B"], atol=1e-14)


@pytest.mark.parametrize("kind", ["trapezoidal", "smooth", "constant"])
@pytest.mark.parametrize("path", [0.05, 2.0], ids=["short", "long"])
def test_a_profile_covers_the_path_within_its_limits(kind, path):
    profile = SpeedProfile(length=path, velocity=0.5, acceleration=0.8, kind=kind)
    t = np.linspace(0.0, profile.duration, 20_001)
    s, v, a = profile.at(t)
    assert s[0] == 0.0
    assert s[-1] == pytest.approx(path, rel=1e-12)
    assert np.all(np.diff(s) >= 0)
    assert v.max() <= 0.5 * (1 + 1e-12)
    np.testing.assert_allclose(np.gradient(s, t)[1:-1], v[1:-1], atol=2e-4)
    if kind != "constant":
        assert np.abs(a).max() <= 0.8 * (1 + 1e-12)
        np.testing.assert_allclose(v[[0, -1]], 0.0, atol=1e-12)
        assert v.max() == pytest.approx(0.5) or np.abs(a).max() == pytest.approx(0.8)
        np.testing.assert_allclose(np.cumsum(a) * (t[1] - t[0]), v, atol=1e-3)


def test_outside_of_its_time_a_profile_is_at_rest():
    profile = SpeedProfile(length=2.0, velocity=0.5, kind="constant")
    s, v, a = profile.at(np.array([-1.0, 100.0]))
    np.testing.assert_array_equal(s, [0.0, 2.0])
    np.testing.assert_array_equal([v, a], 0.0)


def test_without_an_acceleration_limit_a_trapezoid_is_a_constant_speed():
    profile = SpeedProfile(length=2.0, velocity=0.5)
    assert profile.duration == 4.0
    np.testing.assert_allclose(profile.sample(5)[1], [0.0, 0.25, 0.5, 0.75, 1.0])


@pytest.mark.parametrize("wrong", [{"length": 0.0}, {"velocity": np.inf}, {"acceleration": -1.0}, {"length": np.nan}])
def test_a_profile_of_nothing_is_refused(wrong):
    with pytest.raises(PlanningError, match="positive"):
        SpeedProfile(**({"length": 1.0, "velocity": 1.0} | wrong))
    with pytest.raises(PlanningError, match="at least 2"):
        SpeedProfile(1.0, 1.0).sample(1)
