"""Polimi's mecanum base through the main path, its truth from a topic."""

import numpy as np
import pytest
from real.conftest import unchecked

from longreach.app.estimate import estimate
from longreach.measurement import PoseMeasurement


@pytest.mark.parametrize(("name", "bar"), [("bag1", 0.102), ("bag3", 0.210)])
def test_the_wheels_keep_the_bar(estimated, name, bar):
    result = estimated(f"polimi/{name}.bag", "polimi")
    assert result.metrics["wheels"]["ate_rmse"]["value"] <= bar
    assert result.trajectories["truth"].has_heading


def test_glitches_of_the_motion_capture_are_left_out_and_said(estimated):
    remarks = estimated("polimi/bag3.bag", "polimi").remarks
    assert any("rows of the reference jump faster than 3 m/s; they were left out" in remark for remark in remarks)


@pytest.mark.parametrize(("name", "bar"), [("bag1", 0.0210), ("bag3", 0.0296)])
def test_fixes_of_5_cm_every_second_hold_the_base_on_the_map(estimated, name, bar):
    """The bars are 5 % above what one filter of absolute poses had."""
    result = estimated(f"polimi/{name}.bag", "polimi")
    truth, fixes, last = result.trajectories["truth"], [], -np.inf
    for stamp, pose in zip(truth.clock.tolist(), truth.poses, strict=True):
        if stamp - last >= 1.0:
            fixes.append(PoseMeasurement(stamp, pose, np.diag([0.0025, 0.0025, np.inf]), source="fixes"))
            last = stamp
    held = unchecked(estimate, result.recording.replace(fixes=tuple(fixes)), result.robot)
    assert held.metrics["localized"]["ate_rmse"]["value"] <= bar
    np.testing.assert_array_equal(held.trajectories["fused"].poses, result.trajectories["fused"].poses)
