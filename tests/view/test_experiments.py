"""The thesis' experiments, planned from where a robot is."""

import numpy as np
import pytest

from longreach.control.interpolation import sample
from longreach.errors import PlanningError
from longreach.view.experiments import EXPERIMENTS, Asked, erratic_drive


def walls(half):
    side = np.linspace(-half, half, 200)
    edge = np.full(200, half)
    return np.concatenate(
        [np.column_stack(pair) for pair in ((side, edge), (side, -edge), (edge, side), (-edge, side))]
    )


def test_a_drive_begins_and_ends_at_rest_where_the_robot_is_and_keeps_clear_of_what_was_seen(thing):
    q = thing.home.copy()
    q[:3] = 0.3, -0.2, 1.0
    seen = walls(3.0)
    plan = erratic_drive(thing, q, seen, 30.0)
    np.testing.assert_allclose(plan.q[0], q, atol=1e-9)
    np.testing.assert_allclose(plan.velocities[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(plan.q[:, 3:], np.tile(q[3:], (len(plan), 1)))
    assert plan.duration == 30.0
    assert np.ptp(plan.q[:, 0]) > 0.3
    apart = np.linalg.norm(plan.q[:, None, :2] - seen, axis=2)
    assert apart.min() > 0.6


def test_the_velocities_of_a_drive_are_those_of_its_poses(thing):
    plan = erratic_drive(thing, thing.home, np.zeros((0, 2)), 10.0)
    t, h = np.linspace(2.0, 8.0, 40), 1e-5
    (before, *_), (after, *_), (_, v, _) = (sample(plan, t + s) for s in (-h, h, 0.0))
    np.testing.assert_allclose((after - before) / (2 * h), v, atol=1e-4)
    middle = 0.5 * (plan.stamps[:-1] + plan.stamps[1:])
    chords = np.diff(plan.q, axis=0) / np.diff(plan.stamps)[:, None]
    np.testing.assert_allclose(sample(plan, middle)[1], chords, atol=0.02)


def test_without_room_there_is_no_drive(thing):
    with pytest.raises(PlanningError, match="no room"):
        erratic_drive(thing, thing.home, walls(0.7), 30.0)


def test_each_experiment_is_asked_of_the_planner_that_was_chosen(pretender):
    asked = Asked(pretender, "task-priority", np.zeros((0, 2)))
    for name in ("dual-trajectory, 2 m", "manipulability, not optimised"):
        EXPERIMENTS[name](asked)
        method, reference = pretender.orders.pop()
        assert method == "task-priority"
        np.testing.assert_allclose(reference.tool[-1, :3, 3] - reference.tool[0, :3, 3], [2.0, 0.0, 0.0], atol=1e-9)
