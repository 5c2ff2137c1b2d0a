"""The figures of an estimate in space, painted from ordinary, flat, short and wild runs."""

import numpy as np
import pytest

from longreach.evaluation import spatial_figures, style


def run(kind, n=200):
    stamps, states = 0.1 * np.arange(n), np.zeros((n, 15))
    covariance = np.tile(0.01 * np.eye(6), (n, 1, 1))
    if kind == "curve":
        states[:, 0], states[:, 1], states[:, 5] = np.sin(stamps), 1 - np.cos(stamps), (stamps + np.pi) % 6.28 - np.pi
        stamps[100:] += 30.0
    if kind == "uncertain":
        states[:, 2], covariance = 0.01 * np.sin(stamps), 100 * covariance
    if kind == "one row":
        stamps, states, covariance = stamps[:1], states[:1], covariance[:1]
    return stamps, states, covariance


@pytest.mark.parametrize("kind", ["curve", "flat", "uncertain", "one row"])
def test_every_figure_is_painted_without_a_warning(kind):
    stamps, states, covariance = run(kind)
    figures = [
        spatial_figures.plane(states, covariance),
        spatial_figures.height(stamps, states, covariance),
        spatial_figures.angles(stamps, states, covariance),
        spatial_figures.velocity(stamps, states),
    ]
    assert all(style.png(figure).startswith(b"\x89PNG") for figure in figures)
    assert {"plane", "height", "angles", "velocity", "innovation"} <= set(spatial_figures.CAPTIONS)


def test_ellipses_are_three_deviations_wide():
    _, states, covariance = run("curve")
    covariance[:, 0, 0] = 0.04
    axes = spatial_figures.plane(states, covariance).axes[0]
    assert sorted([axes.patches[0].width, axes.patches[0].height]) == pytest.approx([0.6, 1.2])
