"""The relations metric on raw wheel odometry, against values that others measured."""

import bz2

import numpy as np
import pytest

from longreach.evaluation.relations import relation_errors, summary
from longreach.trajectory import PoseTrajectory


def wheel_odometry(path):
    """Robot poses in raw odometry and their stamps, in the order of the file."""
    with bz2.open(path, "rt") as lines:
        rows = [line.split() for line in lines if line.startswith("FLASER ")]
    values = np.array([row[int(row[1]) + 5 : int(row[1]) + 9] for row in rows], dtype=float)
    return PoseTrajectory(values[:, 3], values[:, :3])


@pytest.mark.parametrize(("name", "translation", "rotation_deg"), [("intel", 0.0220, 1.46), ("aces", 0.0373, 0.858)])
def test_wheels_have_the_known_errors_on_short_relations(data, name, translation, rotation_deg):
    odometry = wheel_odometry(data / name / f"{name}.clf.bz2")
    table = np.loadtxt(data / name / f"{name}.relations")
    errors = relation_errors(odometry, table[:, 0], table[:, 1], table[:, [2, 3, 7]])
    assert errors.skipped == 0
    short = summary(errors, 5.0)
    assert short.translation.mean == pytest.approx(translation, abs=5e-5)
    assert np.degrees(short.rotation.mean) == pytest.approx(rotation_deg, abs=5e-3)
    if name == "intel":
        assert short.translation.median == pytest.approx(0.0171, abs=5e-5)
        assert np.degrees(short.rotation.median) == pytest.approx(1.24, abs=5e-3)
