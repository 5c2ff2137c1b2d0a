"""What the page's buttons, keys and gizmo ask of a client."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from longreach.view.cockpit import Cockpit
from longreach.view.replay import read_run


@pytest.fixture
def cockpit(server, pretender, tmp_path):
    return Cockpit(server, pretender, tmp_path)


def until(condition, limit=10.0):
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_drag_shows_a_plan_that_brings_the_tool_only_when_it_is_run(cockpit, pretender):
    q = pretender.state.q
    cockpit.gizmo.position = pretender.robot.forward(q)[:3, 3] + [0.0, 0.0, 0.1]
    cockpit._dragged(SimpleNamespace(phase="end"))
    until(lambda: cockpit.plan is not None and not cockpit.run_button.disabled)
    ((method, T),) = pretender.orders
    assert method == "task-priority"
    np.testing.assert_allclose(T[:3, 3], cockpit.gizmo.position, atol=1e-9)
    np.testing.assert_allclose(T[:3, :3], pretender.robot.forward(q)[:3, :3], atol=1e-6)
    assert np.array_equal(pretender.state.q, q)
    goal = cockpit.plan.q[-1]
    cockpit.run()
    until(lambda: np.allclose(pretender.state.q, goal))
    assert cockpit.plan is None
    assert cockpit.run_button.disabled


def test_a_drag_that_follows_at_once_reaches(cockpit, pretender):
    cockpit._drag.value = "follow at once"
    cockpit._dragged(SimpleNamespace(phase="update"))
    assert pretender.orders[0][0] == "reach"


def test_a_key_drives_and_letting_go_of_it_holds(cockpit, pretender, running):
    running(cockpit.loop)
    cockpit.drive("I")
    until(lambda: ("hold", None) in pretender.orders)
    twists = [twist for order, twist in pretender.orders if order == "velocity"]
    np.testing.assert_allclose(twists[0], [0.3, 0.0, 0.0])


def test_a_session_that_was_recorded_is_shown_again(cockpit, pretender, tmp_path):
    cockpit.record()
    cockpit.drive("I")
    time.sleep(0.3)
    cockpit.record()
    (written,) = tmp_path.glob("session-*.mcap")
    assert written.stat().st_size > 1000
    assert read_run(written, "thing").robot.name == "thing"


def test_a_plan_that_does_not_exist_is_told_and_nothing_is_shown(cockpit, pretender):
    from longreach.errors import PlanningError

    def refuse(goal, method):
        raise PlanningError("There is no way there.")

    pretender.plan = refuse
    cockpit._dragged(SimpleNamespace(phase="end"))
    until(lambda: not cockpit._busy)
    assert cockpit.plan is None
