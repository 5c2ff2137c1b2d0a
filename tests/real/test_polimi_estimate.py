"""Polimi's mecanum base through the main path, its truth from a topic."""

import pytest


@pytest.mark.parametrize(("name", "bar"), [("bag1", 0.102), ("bag3", 0.210)])
def test_the_wheels_keep_the_bar(estimated, name, bar):
    result = estimated(f"polimi/{name}.bag", "polimi")
    assert result.metrics["wheels"]["ate_rmse"]["value"] <= bar
    assert result.trajectories["truth"].has_heading


def test_glitches_of_the_motion_capture_are_left_out_and_said(estimated):
    remarks = estimated("polimi/bag3.bag", "polimi").remarks
    assert any("rows of the reference jump faster than 3 m/s; they were left out" in remark for remark in remarks)
