"""The page in a real browser, without a screen."""

import os
import time

import numpy as np
import pytest
from page_parts import CANVAS, STOP, box, until
from PIL import Image

from longreach.errors import LiveError
from longreach.view.export import page_html
from longreach.view.player import Player
from longreach.view.teleop import Teleop


def picture(page, path):
    page.screenshot(path=path)
    return np.asarray(Image.open(path).convert("RGB"), dtype=float)


def still(page, path):
    """A picture when nothing in it changes any more: without a graphics card a camera moves slowly."""
    after = picture(page, path)
    for _ in range(10):
        page.wait_for_timeout(500)
        before, after = after, picture(page, path)
        if np.abs(after - before).max() <= 20:
            break
    return after


def opened(page, server):
    began = time.monotonic()
    page.goto(server.gate.address)
    page.wait_for_selector("canvas")
    return time.monotonic() - began


def test_a_run_loads_quickly_and_the_robot_moves_in_it(page, server, drive, tmp_path):
    player = Player(server, drive)
    took = opened(page, server)
    assert took < 5.0 * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))  # others may use the machine
    page.get_by_text("longreach").first.wait_for()
    time.sleep(2.0)
    before = picture(page, tmp_path / "a.png")
    player.seek(drive.duration)
    time.sleep(2.0)
    after = picture(page, tmp_path / "b.png")
    assert np.mean(np.abs(after - before).max(axis=2) > 30) > 0.005
    assert page.errors == []


def test_the_ellipse_is_seen_though_it_is_smaller_than_the_base(page, server, pretender, tmp_path):
    page.set_viewport_size({"width": 1000, "height": 700})
    teleop = Teleop(server, pretender, tmp_path)
    opened(page, server)
    until(lambda: server.get_clients(), page)
    page.add_style_tag(content=".mantine-Notification-root { display: none }")  # it says: no graphics card
    page.wait_for_timeout(2000)
    (viewer,) = server.get_clients().values()
    for eye in ((0.0, -0.01, 2.5), (-0.3, -2.0, 0.8)):  # from above, and from the side
        viewer.camera.position, viewer.camera.look_at = np.array(eye), np.array([0.0, 0.0, 0.3])
        pictures = []
        for covariance in (1e-12, 1e-4):  # ten times 25 mm is the larger one's radius: the base is 0.4 m to the side
            pretender.covariance = covariance * np.eye(3)
            teleop.show()
            page.wait_for_timeout(1000)
            pictures.append(still(page, tmp_path / "a.png"))
        before, after = pictures
        changed = np.abs(after - before).max(axis=2) > 20
        assert np.mean(changed) > 0.0015
        blue = after[changed].mean(axis=0)
        assert blue[2] > blue[0] + 40


BUTTONS = "...document.querySelectorAll('button')"


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1000, 500)], ids=["phone", "desktop"])
def test_stop_is_on_the_screen_whatever_the_panel_does(page, server, pretender, tmp_path, width, height):
    page.set_viewport_size({"width": width, "height": height})
    Teleop(server, pretender, tmp_path)
    opened(page, server)
    page.wait_for_function(f"{STOP} && {CANVAS}?.clientHeight > 100")

    def is_seen():
        left, top, right, bottom = box(page, STOP)
        at = page.evaluate(f"document.elementFromPoint({0.5 * (left + right)}, {0.5 * (top + bottom)}).id")
        return 0 <= left < right <= width and 0 <= top < bottom <= height and at == "longreach-stop"

    assert is_seen()
    if width < height:
        _, top, _, bottom = box(page, CANVAS)
        assert bottom - top >= 0.55 * height
        page.get_by_text("longreach", exact=True).first.dispatch_event("click")  # the panel goes
    else:
        page.locator("[aria-label^=Minimize]").first.dispatch_event("click")
    page.wait_for_function(
        "![...document.querySelectorAll('button')].some(b => b.checkVisibility() && b.innerText == 'Record')"
    )
    assert is_seen()
    page.evaluate(f"{STOP}.click()")
    page.wait_for_timeout(500)
    assert pretender.stopped
    assert page.errors == []


NO_CONTACT = "document.getElementById('longreach-banner')"
BANNER = "[...document.querySelectorAll('.mantine-Notification-root')].find(b => b.innerText.startsWith('Stopped'))"


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1000, 700)], ids=["phone", "desktop"])
def test_a_stopped_robot_looks_stopped_and_nothing_in_the_panel_moves(
    page, server, pretender, running, tmp_path, width, height
):
    page.set_viewport_size({"width": width, "height": height})
    running(Teleop(server, pretender, tmp_path).loop)
    opened(page, server)
    record = f"[{BUTTONS}].find(b => b.innerText == 'Record')"
    clear = f"[{BUTTONS}].find(b => b.innerText == 'Clear the stop')"
    page.wait_for_function(f"{STOP} && {record} && {clear}?.disabled && !({BANNER})")
    page.wait_for_timeout(1000)  # the panel is laid out, and the letters are there
    until(lambda: box(page, record) == (page.wait_for_timeout(500), box(page, record))[1], page)
    before = box(page, record)
    pretender.stop()
    page.wait_for_function(f"{BANNER} && !{clear}.disabled")
    page.wait_for_timeout(1000)  # it comes in from the side
    said = page.evaluate(f"({BANNER}).innerText")
    assert "s ago by page" in said
    assert "Cause: emergency stop. The client says stop." in said
    assert "'Clear the stop' lets it take commands again; nothing moves by itself." in said
    np.testing.assert_allclose(box(page, record), before, atol=1.0)
    left, top, right, bottom = box(page, BANNER)
    stop = box(page, STOP)
    assert 0 <= left < right <= width
    assert right <= stop[0] or bottom <= stop[1]  # it does not cover the stop button
    assert (right - left) * (bottom - top) > 20_000  # [pixels²]
    pretender.age = 2.0
    page.wait_for_function(f"{NO_CONTACT}.checkVisibility()")
    black = box(page, NO_CONTACT)
    assert 0 <= black[0] < black[2] <= width
    assert 0 <= black[1] < black[3] <= height
    for other in (stop, box(page, BANNER)):  # neither covers the other, nor the stop button
        assert black[2] <= other[0] or other[2] <= black[0] or black[3] <= other[1] or other[3] <= black[1]
    pretender.age = 0.0
    if width > height:
        page.locator("[aria-label^=Minimize]").first.dispatch_event("click")
        page.wait_for_function(f"!{record}")
    assert page.evaluate(f"({BANNER}).checkVisibility()")
    pretender.reset()
    page.wait_for_function(f"!({BANNER})")
    pretender.stop()
    page.wait_for_function(BANNER)
    assert page.errors == []


def test_what_is_refused_again_and_again_is_one_notice_with_a_count(
    page, server, pretender, running, tmp_path, monkeypatch
):
    monkeypatch.setattr("longreach.view.overlay._LASTS", 3.0)

    def refuse(arm=None, base=None):
        raise LiveError("Somebody else holds the robot.")

    pretender.velocity = refuse
    teleop = Teleop(server, pretender, tmp_path)
    running(teleop.loop)
    opened(page, server)
    notices = "[...document.querySelectorAll('.mantine-Notification-root')].map(b => b.innerText)"
    until(lambda: server.get_clients(), page)

    def pressed_again():
        page.keyboard.down("i")
        page.wait_for_timeout(200)
        page.keyboard.up("i")
        page.wait_for_timeout(200)
        return "times)" in str(page.evaluate(notices))

    until(pressed_again, page)
    told = [text for text in page.evaluate(notices) if "Somebody else holds the robot." in text]
    assert len(told) == 1
    page.wait_for_function(f"!{notices}.join().includes('Somebody')")  # it goes when it is over


def test_a_finger_drives_while_it_is_down_and_stops(browser, server, pretender, running, tmp_path):
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, device_scale_factor=0.5, has_touch=True, is_mobile=True
    )
    page = context.new_page()
    running(Teleop(server, pretender, tmp_path).loop)
    opened(page, server)
    forward = f"[{BUTTONS}].find(b => b.innerText.includes('I') && b.innerText.includes('↑'))"
    page.wait_for_function(f"{STOP} && {forward}")
    page.evaluate(f"{forward}.scrollIntoView()")
    page.wait_for_timeout(500)
    left, top, right, bottom = box(page, forward)
    finger = context.new_cdp_session(page)
    down = [{"x": 0.5 * (left + right), "y": 0.5 * (top + bottom)}]
    finger.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": down})
    until(lambda: [order for order, _ in pretender.orders].count("velocity") > 10, page)
    assert pretender.orders[-1][0] == "velocity"
    finger.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    until(lambda: pretender.orders[-1][0] == "hold", page)
    left, top, right, bottom = box(page, STOP)
    page.touchscreen.tap(0.5 * (left + right), 0.5 * (top + bottom))
    until(lambda: pretender.stopped, page)
    context.close()


def test_the_exported_page_plays_without_a_network(page, drive, tmp_path):
    html = page_html(drive)
    assert len(html) < 5e6
    path = tmp_path / "page.html"
    path.write_text(html, encoding="utf-8")
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(path.as_uri())
    page.frame_locator("iframe").locator("canvas").first.wait_for()
    time.sleep(1.0)
    assert "base by its wheels alone" in page.evaluate("document.querySelector('figcaption').innerText")
    assert page.evaluate("document.querySelector('figure img').alt").startswith("Error of the estimate [mm]")
    assert picture(page, tmp_path / "c.png").std() > 5.0
    assert [url for url in asked if url.startswith(("http:", "https:", "ws:"))] == []
    assert page.errors == []
