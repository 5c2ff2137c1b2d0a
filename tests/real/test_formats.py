"""Recordings in formats that people have: the right path comes out of each."""

import pytest

from longreach.app.estimate import estimate
from longreach.app.inputs import open_run


@pytest.mark.parametrize(
    ("case", "recording", "largest"),
    [("a10_mcap_profile_empty", "drive.mcap", 0.005), ("a13_robotlaser1", "drive.log", 0.010)],
)
def test_the_fused_path_is_right(cases, unchecked, case, recording, largest):
    folder = cases / case
    run = open_run(folder / recording, folder / "robot.yaml", truth=str(folder / "truth.tum"))
    found = estimate(run.recording, run.robot, run.config, truth=run.truth)
    assert found.metrics["fused"]["ate_rmse"]["value"] < largest
    assert found.metrics["fused"]["path_length"]["value"] == pytest.approx(5.164, abs=0.02)
