"""A person's hands on a real robot's page: a mouse in a browser, a robot that another process serves."""

import time

import numpy as np
import pytest
from page_parts import CANVAS, STOP, box, press, until

from longreach.view.bodies import rotation
from longreach.view.replay import read_run
from longreach.view.teleop import Teleop

_GRIP = 0.85  # where on an arrow of the gizmo a hand takes it
_PIXELS = 70.0  # of the gizmo's arrows


@pytest.fixture
def teleop(server, client, running, tmp_path):
    made = Teleop(server, client, tmp_path)
    running(made.loop)
    return made


def hand_on(page, server):
    """Open the page and return what projects points of the world to it."""
    page.goto(server.gate.address)
    until(lambda: server.get_clients() and page.evaluate(f"{STOP} && {CANVAS}?.clientHeight > 100"), page)
    page.add_style_tag(content=".mantine-Notification-root { display: none }")  # it says: no graphics card
    page.wait_for_timeout(1500)
    (viewer,) = server.get_clients().values()
    left, top, right, bottom = box(page, CANVAS)
    width, height = right - left, bottom - top
    focal = 0.5 * height / np.tan(0.5 * viewer.camera.fov)
    R, eye = rotation(*viewer.camera.wxyz), viewer.camera.position

    def seen(point):
        x, y, z = R.T @ (point - eye)
        return np.array([left + 0.5 * width, top + 0.5 * height]) + focal * np.array([x, y]) / z, z / focal

    return seen


def drag(page, start, way):
    page.mouse.move(*start)
    page.wait_for_timeout(300)
    page.mouse.down()
    for part in (0.3, 0.7, 1.0):
        page.mouse.move(*(start + part * way))
    page.mouse.up()


def test_a_drag_of_the_gizmo_shows_a_plan_and_the_tool_arrives_when_it_is_run(page, server, client, teleop):
    client.plan(client.robot.forward(client.state.q), "task-priority")  # its kernels are loaded
    seen = hand_on(page, server)
    T = client.robot.forward(client.state.q)
    middle, metre = seen(T[:3, 3])
    tips = [seen(T[:3, 3] + _GRIP * _PIXELS * metre * T[:3, i])[0] - middle for i in range(3)]
    axis = int(np.argmax(np.linalg.norm(tips, axis=1)))
    drag(page, middle + tips[axis], 25.0 * tips[axis] / np.linalg.norm(tips[axis]))
    until(lambda: teleop.plan is not None, page)
    moved = T[:3, :3].T @ (teleop.gizmo.position - T[:3, 3])
    assert 0.05 < moved[axis] < 1.5
    np.testing.assert_allclose(np.delete(moved, axis), 0.0, atol=0.01)  # along the arrow that was taken
    goal = np.array(teleop.gizmo.position)
    assert np.linalg.norm(client.robot.forward(client.state.q)[:3, 3] - T[:3, 3]) < 0.002  # nothing moves yet
    press(page, "Run the plan")
    until(lambda: client.state.goal == "follow", page)
    until(lambda: client.state.goal != "follow", page)
    assert np.linalg.norm(client.robot.forward(client.state.q)[:3, 3] - goal) < 0.003, client.state.why
    assert page.errors == []


def test_the_robot_is_released_by_a_button_and_when_the_last_browser_goes(page, server, client, teleop):
    page.goto(server.gate.address)
    until(lambda: server.get_clients(), page)
    client.take()
    until(lambda: client.state.holder == "page", page)
    press(page, "Release the robot")
    until(lambda: client.state.holder == "", page)
    client.velocity(base=np.array([0.0, 0.0, 0.1]))
    page.goto("about:blank")
    until(lambda: client.state.holder == "", page)
    assert not client.holds
    assert client.state.goal == "hold"


def test_what_is_driven_by_hand_is_recorded_and_stop_ends_it(page, server, client, teleop, tmp_path):
    hand_on(page, server)
    before = client.state.q[:3].copy()
    press(page, "Record")
    until(lambda: teleop._recorder is not None, page)
    page.keyboard.down("i")
    until(lambda: np.linalg.norm(client.state.q[:2] - before[:2]) > 0.05, page)
    began = time.monotonic()
    left, top, *_ = box(page, STOP)
    page.mouse.click(left + 20, top + 20)
    until(lambda: client.state.latched, page)
    page.keyboard.up("i")
    assert time.monotonic() - began < 20.0  # a browser without a graphics card is slow to see a mouse
    press(page, "Stop recording")
    until(lambda: list(tmp_path.glob("session-*.mcap")) and teleop._recorder is None, page)
    (written,) = tmp_path.glob("session-*.mcap")
    run = read_run(written, "thing")
    way = run.frames[-1].wheels - run.frames[0].wheels
    assert 0.03 < np.linalg.norm(way[:2]) < 5.0
    assert page.errors == []
