import numpy as np

from longreach.configuration import ConfigurationTrajectory, TaskReport
from longreach.evaluation import plan_figures
from longreach.evaluation.style import png

N = 30
NAMES = ("base_x", "base_y", "base_theta", "shoulder", "elbow")


def made(rng):
    stamps = np.linspace(0.0, 3.0, N)
    trajectory = ConfigurationTrajectory(stamps, np.cumsum(rng.normal(size=(N, 5)), axis=0) * 0.1, NAMES)
    unmet = np.arange(N) > 20
    report = TaskReport("tool", np.abs(rng.normal(size=N)) * 1e-9, np.zeros(N), unmet, "It is not met.")
    return trajectory, report


def test_every_figure_can_be_painted_and_names_quantity_and_unit(rng):
    trajectory, report = made(rng)
    path = rng.normal(size=(N, 2))
    figures = [
        plan_figures.plan_paths(path, path, path, None),
        plan_figures.joints(trajectory, [True, True, False, False, False]),
        plan_figures.velocities(trajectory, np.ones(5)),
        plan_figures.manipulability(trajectory.stamps, {"plan": np.ones(N), "optimised": 2 * np.ones(N)}),
        plan_figures.task_errors(trajectory.stamps, [report]),
    ]
    for figure in figures:
        assert png(figure).startswith(b"\x89PNG")
        for axes in figure.axes:
            assert "[" in axes.get_ylabel()


def test_every_joint_has_a_look_of_its_own(rng):
    trajectory, _ = made(rng)
    lines = plan_figures.velocities(trajectory, np.ones(5)).axes[0].get_lines()[:5]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 5
