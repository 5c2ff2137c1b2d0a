"""The ACES log through the main path."""

import numpy as np
import pytest
from real.conftest import SCANS

from longreach.evaluation.relations import summary


@pytest.fixture(scope="module")
def aces(estimated):
    return estimated("aces/aces.clf.bz2", "aces")


def test_every_path_holds_all_scan_stamps(aces):
    assert {name: len(path) for name, path in aces.trajectories.items()} == dict.fromkeys(
        ("fused", "wheels", "lidar"), SCANS
    )


def test_the_fused_path_keeps_the_bars(aces):
    found = summary(aces.evaluation.relation_errors["fused"], 5.0)
    assert found.translation.mean <= 0.0380
    assert np.degrees(found.rotation.mean) <= 0.36
