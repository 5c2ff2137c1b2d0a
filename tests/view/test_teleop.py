"""What the page's buttons, keys and gizmo ask of a client."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from longreach.errors import LiveError
from longreach.view.replay import read_run
from longreach.view.teleop import Teleop


@pytest.fixture
def teleop(server, pretender, tmp_path):
    return Teleop(server, pretender, tmp_path)


def until(condition, limit=10.0):
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_drag_shows_a_plan_that_brings_the_tool_only_when_it_is_run(teleop, pretender):
    q = pretender.state.q
    teleop.gizmo.position = pretender.robot.forward(q)[:3, 3] + [0.0, 0.0, 0.1]
    teleop._dragged(SimpleNamespace(phase="end"))
    until(lambda: teleop.plan is not None and not teleop.run_button.disabled)
    ((method, T),) = pretender.orders
    assert method == "task-priority"
    np.testing.assert_allclose(T[:3, 3], teleop.gizmo.position, atol=1e-9)
    np.testing.assert_allclose(T[:3, :3], pretender.robot.forward(q)[:3, :3], atol=1e-6)
    assert np.array_equal(pretender.state.q, q)
    goal = teleop.plan.q[-1]
    teleop.run()
    until(lambda: np.allclose(pretender.state.q, goal))
    assert teleop.plan is None
    assert teleop.run_button.disabled


def test_a_drag_that_follows_at_once_reaches(teleop, pretender):
    teleop._drag.value = "follow at once"
    teleop._dragged(SimpleNamespace(phase="update"))
    assert pretender.orders[0][0] == "reach"


def twists(pretender):
    return [twist for order, twist in pretender.orders if order == "velocity"]


def test_keys_drive_together_and_letting_go_of_them_holds(teleop, pretender, running):
    running(teleop.loop)
    teleop.control.hold("page", "I")
    until(lambda: len(twists(pretender)) > 2)
    np.testing.assert_allclose(twists(pretender)[0], [0.3, 0.0, 0.0])
    teleop.control.hold("page", "IU")
    until(lambda: np.allclose(twists(pretender)[-1], [0.3, 0.0, 0.45]))
    teleop.control.hold("page", "")
    until(lambda: ("hold", None) in pretender.orders)
    time.sleep(0.2)
    assert pretender.orders[-1] == ("hold", None)


def test_opposite_keys_of_two_pages_stand_against_each_other(teleop):
    teleop.control.hold("one", "IL")
    teleop.control.hold("another", "K")
    np.testing.assert_allclose(teleop.control.twist(), [0.0, -0.3, 0.0])


def test_a_page_that_is_silent_holds_no_key(teleop, pretender, running):
    running(teleop.loop)
    teleop.control.hold("page", "I")
    until(lambda: ("hold", None) in pretender.orders)
    assert len(twists(pretender)) > 2
    assert teleop.control.twist() is None


def test_a_key_whose_driving_is_refused_is_said_once_and_tried_anew_when_it_is_pressed_anew(
    teleop, pretender, running, monkeypatch
):
    said, refused = [], []
    monkeypatch.setattr(teleop, "_tell", lambda title, words: said.append(words))

    def refuse(arm=None, base=None):
        refused.append(base)
        raise LiveError("Somebody holds the robot.")

    pretender.velocity = refuse
    running(teleop.loop)
    for times in (1, 2):
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            teleop.control.hold("page", "I")
            time.sleep(0.02)
        assert said == ["Somebody holds the robot."] * times
        assert len(refused) == times
        teleop.control.hold("page", "")
        time.sleep(0.2)


def test_a_stopped_robot_is_sent_nothing_and_one_notice_says_so(teleop, pretender, running):
    pretender.stop()
    running(teleop.loop)
    teleop._drag.value = "follow at once"
    teleop._dragged(SimpleNamespace(phase="update"))
    (notice,) = teleop._notices._given.values()
    assert notice.title == "The robot is stopped"
    for times in (2, 3):
        end = time.monotonic() + 0.4
        while time.monotonic() < end:
            teleop.control.hold("page", "I")
            time.sleep(0.02)
        assert count(teleop) == times  # a key that stays down says it once
        teleop.control.hold("page", "")
        time.sleep(0.2)
    assert pretender.orders == []


def count(teleop):
    """How often the only notice was given."""
    (notice,) = teleop._notices._given.values()
    return notice.count


def test_a_key_that_is_released_after_a_stop_says_nothing(teleop, pretender, running):
    running(teleop.loop)
    until(lambda: teleop.control.hold("page", "I") or twists(pretender))
    teleop.control.hold("page", "")
    pretender.stop()
    until(lambda: ("hold", None) in pretender.orders)
    assert not teleop._notices._given


def test_a_state_that_cannot_be_drawn_is_said_once_and_the_keys_work_on(
    teleop, pretender, running, caplog, monkeypatch
):
    def fail(frame):
        raise ValueError("no such link")

    with monkeypatch.context() as broken:
        broken.setattr(teleop.scene, "show", fail)
        running(teleop.loop)
        until(lambda: teleop._notices._given and count(teleop) > 2)
        (notice,) = teleop._notices._given.values()
        assert notice.title == "The scene is out of date"
        assert "no such link" in notice.body
        assert len([record for record in caplog.records if "could not show" in record.message]) == 1
        until(lambda: teleop.control.hold("page", "I") or twists(pretender))
        until(lambda: "held by" in teleop._status.content)
    before = len(teleop._trails["base driven"].points)
    pretender._q = pretender._q + 1.0
    until(lambda: len(teleop._trails["base driven"].points) > before)  # it draws again


@pytest.mark.parametrize(("limited", "minded", "words"), [
    ("It is <b>ahead</b>.", True, "Slowed down</b>: It is &lt;b&gt;ahead&lt;/b&gt;."),
    ("", False, "obstacles not minded"),
    ("", True, ""),
])  # fmt: skip
def test_the_status_says_what_slows_the_base_down_and_that_nothing_does_as_text(
    teleop, pretender, limited, minded, words
):
    pretender.limited, pretender.minds_obstacles = limited, minded
    teleop.show()
    assert words in teleop._status.content
    assert ("Slowed down" in teleop._status.content, "not minded" in teleop._status.content) == (
        bool(limited),
        not minded,
    )


@pytest.mark.parametrize("why", ["The laser sees something. The plan has waited 10 s for it to go.", ""])
def test_a_plan_of_the_page_that_ends_early_is_a_notice_and_one_that_is_done_is_none(teleop, pretender, why):
    pretender.why = "of an earlier goal"
    teleop.show()
    teleop.show_plan(pretender.plan(None, "sqp"))
    assert not teleop._notices._given
    teleop.run()
    other = pretender.plan(None, "sqp")
    teleop.show_plan(other)  # while the first runs
    pretender.why = why
    until(lambda: teleop.show() or not teleop._started)
    assert [(n.title, n.body) for n in teleop._notices._given.values()] == [("The plan has ended early", why)] * bool(
        why
    )
    assert teleop.plan is other
    assert len(teleop.preview._paths) == 2
    teleop.show()
    assert len(teleop._notices._given) == bool(why)  # once


def test_a_plan_that_a_stopped_robot_does_not_take_stays_and_runs_when_the_stop_is_cleared(teleop, pretender):
    plan = pretender.plan(None, "sqp")
    teleop.show_plan(plan)
    pretender.stop()
    teleop.run()
    assert teleop.plan is plan
    assert not teleop.run_button.disabled
    pretender.reset()
    teleop.run()
    assert teleop.plan is None
    until(lambda: np.allclose(pretender.state.q, plan.q[-1]))


def test_the_robot_is_released_a_second_after_the_last_browser_unless_one_comes_back(
    teleop, pretender, running, monkeypatch
):
    browsers = {}
    monkeypatch.setattr(teleop._server, "get_clients", lambda: browsers)
    released = []
    monkeypatch.setattr(pretender, "release", lambda: released.append(time.monotonic()))
    running(teleop.loop)
    time.sleep(1.5)
    assert not released  # nobody has opened the page yet
    browsers[1] = browsers[2] = SimpleNamespace()
    time.sleep(0.3)
    del browsers[1]
    time.sleep(1.5)
    assert not released
    del browsers[2]
    time.sleep(0.5)
    browsers[3] = SimpleNamespace()
    time.sleep(1.5)
    assert not released
    gone = time.monotonic()
    del browsers[3]
    until(lambda: released)
    assert released[0] > gone + 0.5  # it was seen a picture before
    time.sleep(1.5)
    assert len(released) == 1


def test_a_session_that_was_recorded_is_shown_again(teleop, pretender, tmp_path):
    teleop.record()
    time.sleep(0.3)
    teleop.record()
    (written,) = tmp_path.glob("session-*.mcap")
    assert written.stat().st_size > 1000
    assert len(read_run(written, "thing").frames) > 1


def test_a_recording_that_cannot_go_on_ends_and_the_page_says_why(teleop, monkeypatch):
    said = []
    monkeypatch.setattr(teleop, "_tell", lambda title, body: said.append((title, body)))
    teleop.record()
    teleop._recorder.error = "run.mcap cannot be written any more: No space left on device."
    teleop.show()
    assert said[-1][0] == "The recording is not whole"
    assert "No space left" in said[-1][1]
    assert teleop.record_button.label == "Record"


def test_a_recording_that_cannot_begin_is_said_on_the_page(teleop, monkeypatch, tmp_path):
    said = []
    monkeypatch.setattr(teleop, "_tell", lambda title, body: said.append(body))
    teleop._folder = tmp_path / "file"
    teleop._folder.touch()
    teleop._try(teleop.record)
    assert "cannot be written" in said[0]
    assert teleop.record_button.label == "Record"


def test_a_plan_that_does_not_exist_is_told_and_nothing_is_shown(teleop, pretender):
    from longreach.errors import PlanningError

    def refuse(goal, method):
        raise PlanningError("There is no way there.")

    pretender.plan = refuse
    teleop._dragged(SimpleNamespace(phase="end"))
    until(lambda: not teleop._busy)
    assert teleop.plan is None


def test_a_watchers_page_says_so_and_has_nothing_that_would_be_refused(server, pretender, tmp_path):
    pretender.role, pretender.stopped = "watcher", time.monotonic() - 60.0
    page = Teleop(server, pretender, tmp_path)
    page.show()
    assert "You watch" in page._status.content
    assert not any(part.visible for part in (page._reset, page._release, page.gizmo))
    _, sentence = page._banner(pretender.state)
    assert "An operator has to clear the stop" in sentence


def test_what_is_wrong_with_the_readings_is_in_the_panel_as_text_and_each_is_a_notice_once(server, pretender, tmp_path):
    page = Teleop(server, pretender, tmp_path)
    pretender.remarks = ("The IMU feels <b>gravity</b> downwards.",)
    for _ in range(3):
        page.show()
    assert "feels &lt;b&gt;gravity" in page._status.content
    (notice,) = page._notices._given.values()
    assert (notice.count, notice.body) == (1, pretender.remarks[0])
