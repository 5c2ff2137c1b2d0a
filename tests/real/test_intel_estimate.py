"""The Intel log through the main path: a clock that runs backwards, and fixes that hold the estimate on the map."""

import numpy as np
import pytest


@pytest.fixture(scope="module")
def intel(estimated):
    return estimated("intel/intel.clf.bz2", "intel")


def test_stamps_that_run_backwards_are_kept_and_said(intel):
    assert np.count_nonzero(np.diff(intel.trajectories["fused"].stamps) <= 0) == 631
    assert intel.remarks[0].startswith("631 of 13631 stamps run backwards; the order of the file was kept")


def test_fixes_of_5_cm_every_5_s_hold_the_whole_run(held_by_fixes):
    localized = held_by_fixes.metrics["localized"]
    assert localized["pairs"]["value"] > 100
    assert localized["ate_rmse"]["value"] <= 0.10
    statuses = [c.status for c in held_by_fixes.corrections if c.source == "fixes"]
    assert len(statuses) == len(held_by_fixes.recording.fixes) > 40
    assert set(statuses) == {"used"}
