"""Several late measurements taken at once, against one after the other."""

import numpy as np

from longreach.estimation.planar import filter as planar_filter
from longreach.measurement import PoseMeasurement, TwistMeasurement


def test_events_taken_at_once_in_any_order_give_what_they_give_one_by_one(rng):
    events = [
        TwistMeasurement(0.1 * i, rng.normal(0.0, 0.1, 3), 0.01 * np.eye(3), source="wheels") for i in range(1, 12)
    ] + [PoseMeasurement(0.1 * i + 0.03, rng.normal(0.0, 0.1, 3), 0.04 * np.eye(3), source="fix") for i in range(11)]
    start = planar_filter.init(0.0, np.zeros(3))
    one, corrections = start, []
    for event in planar_filter.in_order(events):
        one, correction = planar_filter.step(one, event)
        corrections.append(correction)
    late = [event for event in events if event.source == "fix"]
    many, _ = planar_filter.steps(start, [event for event in events if event.source == "wheels"])
    many, decided = planar_filter.steps(many, rng.permutation(np.array(late, dtype=object)).tolist())
    np.testing.assert_array_equal(many.newest.mean, one.newest.mean)
    np.testing.assert_array_equal(many.newest.P, one.newest.P)
    assert [c.nis for c in decided] == [c.nis for c in corrections if c.source == "fix"]
    after, none = planar_filter.steps(many, [])
    assert (after.buffer, none) == (many.buffer, [])


def test_what_is_too_late_is_refused_in_its_place_and_counted():
    state, _ = planar_filter.steps(
        planar_filter.init(0.0, np.zeros(3)), [TwistMeasurement(9.0, np.zeros(3), np.eye(3), source="w")]
    )
    both = [TwistMeasurement(stamp, np.zeros(3), np.eye(3), source="w") for stamp in (9.1, 1.0)]
    state, decided = planar_filter.steps(state, both)
    assert [c.status for c in decided] == ["refused", "used"]
    assert state.tallies["w"].refused == 1
