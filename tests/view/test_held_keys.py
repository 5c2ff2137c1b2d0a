"""Keys and buttons that are held, in a browser: a robot that another process serves drives as long, and no longer."""

import os
import time

import numpy as np
import pytest
from page_parts import CANVAS, STOP, box, until

from longreach.view.teleop import Teleop

PAD = "document.querySelector('[data-drive={}]')"


@pytest.fixture
def teleop(page, server, client, running, tmp_path):
    """The robot's page, open and not redrawn, for that takes all of a machine without a graphics card.

    `window.released` is when a key or button was let go of, on the wall clock [s].
    """
    made = Teleop(server, client, tmp_path)
    running(made.control.drive)
    page.goto(server.gate.address)
    until(lambda: page.evaluate(f"{STOP} && {CANVAS}?.clientHeight > 100"), page)
    page.wait_for_timeout(2000)
    page.evaluate("""() => {
        for (const kind of ['keyup', 'pointerup', 'blur'])
            window.addEventListener(kind, () => { window.released ??= Date.now() / 1e3; }, true);
    }""")
    return made


@pytest.fixture
def states(client):
    """When each state came on the wall clock [s], where the base was and how fast."""
    heard = []
    end = client.on_state(lambda state: heard.append((time.time(), state.q[:3].copy(), state.velocity[:3].copy())))
    yield heard
    end()


def slow():
    """How much slower than idle this machine is; others may use it."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def release(page, let_go):
    page.evaluate("window.released = undefined")
    let_go()
    until(lambda: page.evaluate("window.released !== undefined"), page)
    return page.evaluate("window.released")


def at_rest(client):
    return np.abs(client.state.velocity[:3]).max() < 1e-3


def rolled_on(states, released):
    """How far the base went after a time of the wall clock [m], and how fast it was then [m/s]."""
    times = np.array([when for when, _, _ in states])
    first = max(int(np.searchsorted(times, released)) - 1, 0)
    return np.linalg.norm(states[-1][1][:2] - states[first][1][:2]), np.linalg.norm(states[first][2][:2])


def drive(page, client, keys, speed):
    for key in keys:
        page.keyboard.down(key)
    until(lambda: np.linalg.norm(client.state.velocity[:2]) > 0.98 * speed, page)
    page.wait_for_timeout(300)


def check_braked(page, client, states, released):
    until(lambda: at_rest(client), page)
    page.wait_for_timeout(300)
    far, fast = rolled_on(states, released)
    braking = fast**2 / (2.0 * client.robot.description.acceleration_limits[0])
    print(f"{far:.3f} m from {fast:.2f} m/s, of which {braking:.3f} m to brake")
    assert far < braking + 0.1 * slow() * fast
    return fast


def test_a_base_brakes_at_its_limit_as_soon_as_the_key_is_released(page, client, teleop, states):
    for speed in (0.2, 0.5, 0.8):
        teleop._pace.value = speed
        for _ in range(5):  # where others use the machine the robot may have stopped before
            drive(page, client, "i", speed)
            if check_braked(page, client, states, release(page, lambda: page.keyboard.up("i"))) > 0.9 * speed:
                break
        else:
            pytest.skip("This machine is too busy to drive a robot.")
    assert page.errors == []


def test_a_key_that_is_held_drives_without_a_jerk(page, client, teleop, states, monkeypatch):
    """Others may use the machine: what counts is a second in which neither the page nor the robot had a gap."""
    heard, hold = [], teleop.control.hold
    monkeypatch.setattr(teleop.control, "hold", lambda *said: (heard.append(time.time()), hold(*said)))
    teleop._pace.value = 0.5
    drive(page, client, "i", 0.5)
    steady = []

    def a_second_without_a_gap():
        began = time.time()
        for _ in range(20):
            page.keyboard.down("i")  # as a system repeats it
            page.wait_for_timeout(50)
        gaps = np.diff([when for when in heard if when > began - 1.0])
        beats = np.diff([when for when, _, _ in states if when > began - 1.0])
        steady[:] = [velocity[0] for when, _, velocity in states if when > began]
        return gaps.max() < 0.2 and beats.max() < 0.1

    end = time.monotonic() + 60.0
    while not a_second_without_a_gap():
        if time.monotonic() > end:
            pytest.skip("This machine has not had a quiet second in a minute.")
    page.keyboard.up("i")
    assert len(steady) > 50
    np.testing.assert_allclose(steady, 0.5, atol=0.05)  # the wheels are noisy


def test_forward_and_turn_are_held_together_and_each_is_released_by_itself(page, client, teleop):
    teleop._pace.value = 0.4
    drive(page, client, "iu", 0.4)
    until(lambda: np.allclose(client.state.velocity[:3], [0.4, 0.0, 0.6], atol=0.02), page)
    page.keyboard.up("i")
    until(lambda: np.allclose(client.state.velocity[:3], [0.0, 0.0, 0.6], atol=0.02), page)
    page.keyboard.up("u")
    until(lambda: at_rest(client), page)


def test_a_base_stands_when_the_page_freezes_loses_the_focus_or_is_left(page, client, teleop, states):
    teleop._pace.value = 0.5
    drive(page, client, "i", 0.5)
    before = time.time()
    page.evaluate("setTimeout(() => { const since = Date.now(); while (Date.now() - since < 3000); }, 0)")
    while not at_rest(client) and time.time() < before + 2.5:
        time.sleep(0.01)
    assert at_rest(client)  # while the page still says nothing
    page.keyboard.up("i")
    for lost in ("window.dispatchEvent(new Event('blur'))", "location.href = 'about:blank'"):
        drive(page, client, "i", 0.5)
        left = time.time()
        page.evaluate(lost)
        check_braked(page, client, states, left)
        page.keyboard.up("i")


def test_buttons_drive_while_they_are_down_and_brake_as_keys_do(page, client, teleop, states):
    teleop._pace.value = 0.5
    page.evaluate(f"{PAD.format('I')}.scrollIntoView()")
    page.wait_for_timeout(500)
    left, top, right, bottom = box(page, PAD.format("I"))
    page.mouse.move(0.5 * (left + right), 0.5 * (top + bottom))
    page.mouse.down()
    page.keyboard.down("u")  # with the other hand
    until(lambda: np.allclose(client.state.velocity[:3], [0.5, 0.0, 0.75], atol=0.03), page)
    page.keyboard.up("u")
    until(lambda: np.allclose(client.state.velocity[:3], [0.5, 0.0, 0.0], atol=0.03), page)
    page.mouse.move(1.0, 1.0)  # it is held wherever the pointer goes
    page.wait_for_timeout(1000)
    until(lambda: client.state.velocity[0] > 0.45, page)
    check_braked(page, client, states, release(page, page.mouse.up))
