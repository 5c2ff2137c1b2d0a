"""What a scan corrects on real logs: no more than its innovation is worth, and never the reference."""

import numpy as np
import pytest
from correction_bounds import corrections_of
from real.conftest import unchecked

from longreach.app.filter_events import lidar_events, wheel_events
from longreach.estimation import fusion, offline
from longreach.odometry.wheel import wheel_odometry

LOGS = ("intel", "aces", "fr079", "csail")


@pytest.mark.parametrize("name", LOGS)
def test_a_correction_is_as_large_as_its_innovation_and_does_not_move_the_reference(estimated, name, monkeypatch):
    result = estimated(f"{name}/{name}.clf.bz2", name)
    wheels = wheel_odometry(result.recording.wheels, result.robot, result.config.wheels).measurements
    events = fusion.in_order([*wheel_events(wheels), *lidar_events(result.matches)])
    start = fusion.init(events[0].stamp, np.zeros(3), None, result.config.filter)
    taken = corrections_of(monkeypatch, lambda: unchecked(offline.run, start, events))
    assert len(taken) > len(result.recording.scans)
    assert max(correction.reference_moved for correction in taken) == 0.0
    for c in taken:
        assert c.squared <= c.nis * (1.0 + 1e-6) + 1e-9
        if c.whole:
            reach = np.hypot(*c.innovation[:2]) + c.distance * abs(c.innovation[2])
            assert np.hypot(*c.moved[:2]) <= 3.0 * reach + 0.002  # what x has in common with y and θ is of mm
