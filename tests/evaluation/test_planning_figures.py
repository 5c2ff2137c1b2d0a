"""Figures of plans show every plan and its tolerances, and convergence on a scale that it fills."""

import numpy as np

from longreach.evaluation.planning_figures import convergence, optimised_against_not
from longreach.evaluation.style import png


def some_plans(n=20):
    base = np.column_stack([np.linspace(0, 2, n), np.zeros(n), np.zeros(n)])
    moved = base + np.array([0.005, 0.0, 0.1])
    tool = base + 0.5
    measures = {"not optimised": np.ones(n), "optimised": np.linspace(1.1, 1.2, n)}
    return measures, {"not optimised": base, "optimised": moved}, dict.fromkeys(measures, tool), base


def test_figure_6_5_has_four_panels_with_every_plan():
    fig = optimised_against_not(*some_plans(), radius=0.01, band=0.1)
    assert len(fig.axes) == 4
    assert all(len(axes.lines) == 2 for axes in fig.axes)
    tool, measure, heading, position = fig.axes
    np.testing.assert_allclose(heading.lines[1].get_ydata(), 0.1)
    np.testing.assert_allclose(position.lines[1].get_ydata(), 5.0)
    assert heading.collections
    assert position.collections
    assert measure.get_legend() is not None
    assert np.ptp(tool.get_ylim()) >= 0.1  # errors of rounding do not fill the panel
    assert png(fig).startswith(b"\x89PNG")


def test_convergence_shows_each_iteration():
    history = [
        {"merit": 3.0 + 10.0**-k, "violation": 10.0 ** (-2 * k), "trust": 0.1 * 1.5**k, "penalty": 10.0}
        for k in range(6)
    ]
    fig = convergence(history)
    assert [len(axes.lines[0].get_xdata()) for axes in fig.axes] == [6, 6, 6, 6]
    assert all(axes.get_yscale() == "log" for axes in fig.axes)
    assert fig.axes[0].lines[0].get_ydata()[0] > 0.9
    assert png(fig).startswith(b"\x89PNG")


def test_an_optimisation_without_iterations_is_drawn_empty():
    assert len(convergence([]).axes) == 4
