import sys
from dataclasses import replace
from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest

from longreach.evaluation import figures
from longreach.evaluation.alignment import associate
from longreach.evaluation.consistency import Consistency, nis, pose_errors
from longreach.evaluation.metrics import mse_over_time
from longreach.evaluation.relations import RelationErrors, relation_errors
from longreach.evaluation.scan_map import scan_map, scan_points
from longreach.evaluation.style import looks, png, thin
from longreach.geometry import se2
from longreach.measurement import LaserScan
from longreach.trajectory import PoseTrajectory

NONE = PoseTrajectory(np.zeros(0), np.zeros((0, 3)))


def all_figures(drive, estimate, rng):
    pairs = associate(estimate, drive)
    i, j = rng.integers(0, len(drive), size=(2, 50))
    relations = relation_errors(estimate, drive.stamps[i], drive.stamps[j], se2.between(drive.poses[i], drive.poses[j]))
    clock = np.linspace(0.0, 40.0, 300)
    sources = ["wheels", "lidar", "gps"] * 100
    trajectories = {"truth": drive, "wheels": estimate, "lidar": drive, "fused": drive, "another": estimate}
    yield figures.paths(trajectories, "Paths")
    yield figures.squared_errors({"fused": mse_over_time(pairs), "wheels": mse_over_time(pairs)}, "Errors")
    yield figures.error_with_bounds(pose_errors(pairs), "Bounds")
    yield figures.relation_distributions({"fused": relations}, "Relations")
    yield figures.innovation(nis(clock, sources, rng.chisquare(3, 300), [3] * 300), "Innovations")
    yield scan_map(drive, rng.normal(size=(5000, 2)), "Map")


def visible_texts(figure):
    return [t for t in figure.findobj(mpl.text.Text) if t.get_visible() and t.get_text().strip()]


def written_beside(figure):
    """Title, axis labels and legends."""
    parts = [*figure.texts]
    for axes in figure.axes:
        parts += [label for label in (axes.xaxis.label, axes.yaxis.label) if label.get_text()]
        parts += [axes.get_legend()] if axes.get_legend() else []
    return parts


def test_all_text_is_large_enough_inside_the_figure_and_apart(drive, disturb, rng):
    for figure in all_figures(drive, disturb(drive), rng):
        assert png(figure).startswith(b"\x89PNG")
        figure.draw_without_rendering()
        for text in visible_texts(figure):
            assert text.get_fontsize() >= 9
        boxes = [part.get_window_extent() for part in written_beside(figure)]
        for box in boxes:
            assert figure.bbox.x0 <= box.x0
            assert figure.bbox.y0 <= box.y0
            assert box.x1 <= figure.bbox.x1
            assert box.y1 <= figure.bbox.y1
        assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))


def test_every_axis_names_its_unit(drive, disturb, rng):
    for figure in all_figures(drive, disturb(drive), rng):
        labels = [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
        assert len(labels) >= 2
        assert all("[" in label for label in labels)


def test_figures_leave_no_global_state(drive, disturb, rng):
    before = dict(mpl.rcParams)
    list(all_figures(drive, disturb(drive), rng))
    assert dict(mpl.rcParams) == before
    evaluation = [m for name, m in sys.modules.items() if name.startswith("longreach.evaluation")]
    assert not any(hasattr(module, "plt") or hasattr(module, "pyplot") for module in evaluation)


def test_paths_have_one_scale_and_one_start_in_the_legend(drive):
    (axes,) = figures.paths({"truth": drive, "wheels": drive}).axes
    assert axes.get_aspect() == 1.0
    assert axes.get_legend_handles_labels()[1].count("start") == 1


def test_no_two_trajectories_look_alike():
    names = dict.fromkeys(["truth", "wheels", "lidar", "fused", "gps", "imu"])
    found = looks(names).values()
    assert len({look.colour for look in found}) == len(names)
    assert len({str(look.line) for look in found}) >= len(names) - 1  # truth and fused are solid, of another width
    assert len({(str(look.line), look.width) for look in found}) == len(names)


def test_long_lines_are_thinned_and_keep_both_ends():
    x = np.arange(40_001.0)
    (kept,) = thin(x)
    assert len(kept) <= 5002
    assert kept[0] == 0
    assert kept[-1] == 40_000
    (few,) = thin(x[:100])
    assert len(few) == 100


@pytest.mark.parametrize("n", [1, 2])
def test_figures_of_very_short_runs_can_be_drawn(drive, disturb, n):
    estimate = disturb(drive)
    short = PoseTrajectory(estimate.stamps[:n], estimate.poses[:n], estimate.covariance[:n])
    pairs = associate(short, drive)
    one = nis(np.zeros(n), ["wheels"] * n, np.ones(n), [3] * n)
    relations = RelationErrors(np.ones(n), np.zeros(n), np.zeros(n))
    for figure in (
        figures.paths({"fused": short}),
        figures.squared_errors({"fused": mse_over_time(pairs)}),
        figures.error_with_bounds(pose_errors(pairs)),
        figures.relation_distributions({"fused": relations}),
        figures.innovation(one),
        scan_map(short, np.zeros((n, 2))),
    ):
        png(figure)


def test_figures_of_nothing_can_be_drawn():
    nothing = np.zeros(0)
    for figure in (
        figures.paths({}),
        figures.paths({"fused": NONE}),
        figures.squared_errors({}),
        figures.relation_distributions({"fused": RelationErrors(nothing, nothing, nothing)}),
        figures.innovation({}),
        figures.innovation({"wheels": Consistency(nothing, nothing, nothing)}),
        scan_map(NONE, np.zeros((0, 2))),
    ):
        png(figure)


def test_errors_too_far_apart_for_a_linear_scale_get_a_logarithmic_one(drive, disturb):
    far = mse_over_time(associate(disturb(drive), drive))
    shorter = PoseTrajectory(drive.stamps[:-9], drive.poses[:-9] + np.array([1e-5, 0.0, 0.0]))
    near = mse_over_time(associate(shorter, drive), "none")
    assert figures.squared_errors({"fused": near, "wheels": far}).axes[0].get_yscale() == "log"
    assert figures.squared_errors({"fused": far, "wheels": far}).axes[0].get_yscale() == "linear"
    assert figures.squared_errors({"fused": far}).axes[0].get_ylim()[0] == 0


def test_without_headings_the_squared_errors_have_one_panel(drive):
    pairs = associate(drive, replace(drive, has_heading=False))
    assert len(figures.squared_errors({"fused": mse_over_time(pairs, "rigid")}).axes) == 1


@pytest.mark.parametrize("up", [1, -1])
def test_scan_points_of_a_wall_fall_on_it_from_every_pose(drive, up):
    """A laser beside the centre of the base, turned, upright or upside down, sees the wall x = 30."""
    c, s = np.cos(0.4), np.sin(0.4)
    mount = np.array([[c, -up * s, 0, 0.3], [s, up * c, 0, 0.1], [0, 0, up, 0.2], [0, 0, 0, 1]])
    angles = up * np.linspace(-1.0, 1.0, 21)
    scans = []
    for stamp, pose in zip(drive.stamps, drive.poses, strict=True):
        origin = se2.transform(pose, mount[:2, 3][None])[0]
        across = np.cos(pose[2] + 0.4 + angles)
        ranges = np.where(across > 0.1, (30.0 - origin[0]) / np.maximum(across, 0.1), np.inf)
        scans.append(LaserScan(float(stamp), ranges, -1.0, 0.1))
    points = scan_points(drive, [*scans, replace(scans[0], stamp=1e6)], mount)
    assert len(points) > 500
    np.testing.assert_allclose(points[:, 0], 30.0, atol=1e-9)


def test_the_map_is_dark_where_the_points_are(rng):
    points = np.stack((rng.uniform(-5, 5, 20_000), np.full(20_000, 2.0)), axis=1)
    (axes,) = scan_map(PoseTrajectory(np.arange(2.0), np.array([[-5.0, 0, 0], [5.0, 0, 0]])), points).axes
    image = axes.images[0]
    assert image.origin == "lower"
    shades = np.asarray(image.get_array())
    _, _, bottom, top = image.get_extent()
    rows = np.flatnonzero(shades.any(axis=1))
    y = bottom + (rows + 0.5) / len(shades) * (top - bottom)
    np.testing.assert_allclose(y, 2.0, atol=0.02)
