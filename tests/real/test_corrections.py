"""Real logs one reading at a time: the rows of the estimate, and no correction beyond what its innovation is worth."""

import numpy as np
import pytest
from arrivals import late, readings_of, settled_rows
from correction_bounds import corrections_of
from real.conftest import unchecked

from longreach.localization import localizer

LOGS = ("intel", "aces", "fr079", "csail")


def one_by_one(result, rng):
    """The rows of a recording once more, one reading at a time as they arrive, one in a hundred of them late."""
    arriving = late(readings_of(result.recording), rng, 0.3, share=0.01)
    state = localizer.init(result.robot, result.config)
    return unchecked(settled_rows, state, ([reading] for reading in arriving))[0]


def assert_same(fused, rows):
    online = {row.stamp: row for row in rows}
    for stamp, pose, covariance in zip(fused.clock.tolist(), fused.poses, fused.covariance, strict=True):
        np.testing.assert_allclose(online[stamp].pose, pose, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(online[stamp].covariance, covariance, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("path", "robot"), [("brenner", "brenner"), ("polimi/bag1.bag", "polimi"), ("polimi/bag3.bag", "polimi")]
)
def test_one_by_one_and_late_it_is_the_estimate(estimated, path, robot, rng):
    result = estimated(path, robot)
    assert_same(result.trajectories["fused"], one_by_one(result, rng))


@pytest.mark.parametrize("name", LOGS)
def test_one_by_one_and_late_it_is_the_estimate_and_each_correction_is_as_large_as_its_innovation(
    estimated, name, monkeypatch, rng
):
    result, rows = estimated(f"{name}/{name}.clf.bz2", name), []
    taken = corrections_of(monkeypatch, lambda: rows.extend(one_by_one(result, rng)))
    assert_same(result.trajectories["fused"], rows)
    assert len(taken) > len(result.recording.scans)
    assert max(correction.reference_moved for correction in taken) == 0.0
    for c in taken:
        assert c.squared <= c.nis * (1.0 + 1e-6) + 1e-9
        if c.whole:
            reach = np.hypot(*c.innovation[:2]) + c.distance * abs(c.innovation[2])
            assert np.hypot(*c.moved[:2]) <= 3.0 * reach + 0.002  # what x has in common with y and θ is of mm
