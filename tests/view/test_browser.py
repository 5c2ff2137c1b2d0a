"""The page in a real browser, without a screen."""

import os
import time

import numpy as np
from PIL import Image

from longreach.view.cockpit import Cockpit
from longreach.view.export import page_html
from longreach.view.player import Player


def picture(page, path):
    page.screenshot(path=path)
    return np.asarray(Image.open(path).convert("RGB"), dtype=float)


def opened(page, server):
    began = time.monotonic()
    page.goto(f"http://127.0.0.1:{server.get_port()}")
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


def test_stop_in_the_browser_stops(page, server, pretender, tmp_path):
    Cockpit(server, pretender, tmp_path)
    opened(page, server)
    page.get_by_text("STOP").first.wait_for()
    page.get_by_text("STOP").first.dispatch_event("click")
    end = time.monotonic() + 10.0
    while not pretender.stopped:
        assert time.monotonic() < end
        page.wait_for_timeout(20)
    assert page.errors == []


def test_the_exported_page_plays_without_a_network(page, drive, tmp_path):
    html = page_html(drive)
    assert len(html) < 5e6
    path = tmp_path / "page.html"
    path.write_text(html, encoding="utf-8")
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(path.as_uri())
    page.wait_for_selector("canvas")
    time.sleep(1.0)
    assert picture(page, tmp_path / "c.png").std() > 5.0
    assert [url for url in asked if url.startswith(("http:", "https:", "ws:"))] == []
    assert page.errors == []
