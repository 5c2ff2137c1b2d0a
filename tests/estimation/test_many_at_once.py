"""Several late measurements taken at once, against one after the other."""

import numpy as np

from longreach.estimation import fusion
from longreach.measurement import PoseMeasurement, TwistMeasurement


def test_events_taken_at_once_in_any_order_give_what_they_give_one_by_one(rng):
    events = [
        TwistMeasurement(0.1 * i, rng.normal(0.0, 0.1, 3), 0.01 * np.eye(3), source="wheels") for i in range(1, 12)
    ] + [PoseMeasurement(0.1 * i + 0.03, rng.normal(0.0, 0.1, 3), 0.04 * np.eye(3), source="fix") for i in range(11)]
    start = fusion.init(0.0, np.zeros(3))
    one, corrections = start, []
    for event in fusion.in_order(events):
        one, correction = fusion.step(one, event)
        corrections.append(correction)
    late = [event for event in events if event.source == "fix"]
    many, _ = fusion.steps(start, [event for event in events if event.source == "wheels"])
    many, told = fusion.steps(many, rng.permutation(np.array(late, dtype=object)).tolist())
    np.testing.assert_array_equal(many.history[-1].mean, one.history[-1].mean)
    np.testing.assert_array_equal(many.history[-1].P, one.history[-1].P)
    assert [c.nis for c in told] == [c.nis for c in corrections if c.source == "fix"]
    after, none = fusion.steps(many, [])
    assert (after.buffer, none) == (many.buffer, [])


def test_what_is_too_late_is_refused_in_its_place_and_counted():
    state, _ = fusion.steps(fusion.init(0.0, np.zeros(3)), [TwistMeasurement(9.0, np.zeros(3), np.eye(3), source="w")])
    both = [TwistMeasurement(stamp, np.zeros(3), np.eye(3), source="w") for stamp in (9.1, 1.0)]
    state, told = fusion.steps(state, both)
    assert [c.status for c in told] == ["refused", "used"]
    assert state.counters["w"].refused == 1
