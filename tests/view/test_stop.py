"""STOP from the page: whatever has the focus, and what the page says when it cannot reach the robot."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest
from page_parts import CANVAS, STOP, until

import longreach as lr
from longreach.view.teleop import Teleop

BANNER = "document.getElementById('longreach-banner')"
_VIEW = "import sys; from longreach.cli.main import main; main(sys.argv[1:])"
_FOCUSABLE = "button, input, select, textarea, summary, a[href], [tabindex], canvas"


class View:
    """`longreach view` of a served robot, in a process of its own."""

    def __init__(self, served):
        self.served = served
        command = [sys.executable, "-u", "-c", _VIEW, "view", "--connect", served.address, "--port", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        for line in self.process.stdout:
            found = re.search(r"http://127\.0\.0\.1:\d+/[\w-]+/", line)
            if found:
                self.address = found.group()
                return
        raise AssertionError("longreach view has not said its address")

    def end(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


@pytest.fixture(scope="module")
def views():
    """The views that tests have started; all end with the module."""
    views = []
    yield views
    for one in views:
        one.end()


@pytest.fixture
def view(views, served):
    """A view of the served robot: one for all tests, until one of them kills it or the robot."""
    if not views or views[-1].served is not served or views[-1].process.poll() is not None:
        views.append(View(served))
    views[-1].process.send_signal(signal.SIGCONT)
    return views[-1]


def limit(seconds):
    """As long on an idle machine; others may use it."""
    return seconds * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def says(page):
    """What the banner says, nothing where it is not shown."""
    return page.evaluate(f"{BANNER}.checkVisibility() ? {BANNER}.innerText : ''")


def is_off(page):
    return page.evaluate(f"{STOP}.classList.contains('longreach-off')")


def open_quiet(page, address):
    """Open the page and wait until all is well in it."""
    page.goto(address)
    until(lambda: page.evaluate(f"{STOP} && {CANVAS}?.clientHeight > 100"), page)
    page.wait_for_timeout(2000)
    until(lambda: not says(page) and not is_off(page), page)
    page.evaluate(f"""() => {{
        window.seen = [];
        new MutationObserver(() => window.seen.push([Date.now() / 1e3, {BANNER}.style.display, {BANNER}.innerText]))
            .observe({BANNER}, {{ attributes: true, childList: true, subtree: true, characterData: true }});
    }}""")


def seconds_until_it_says(page, words, since):
    """How long after a time of the wall clock the banner showed some words [s]."""
    find = f"window.seen.find(([when, shown, said]) => when > {since} && shown == 'block' && said.includes('{words}'))"
    until(lambda: page.evaluate(f"!!{find}"), page)
    assert words in says(page)
    assert is_off(page)
    took = page.evaluate(f"{find}[0]") - since
    print(f"{words}: after {took:.2f} s")
    return took


def test_space_stops_whatever_has_the_focus_and_does_nothing_else(page, server, pretender, running, tmp_path):
    teleop = Teleop(server, pretender, tmp_path)
    running(teleop.loop)
    page.goto(server.gate.address)
    until(lambda: page.evaluate(f"{STOP} && {CANVAS}?.clientHeight > 100"), page)
    page.wait_for_timeout(1000)
    count = page.evaluate(f"(window.all = [...document.querySelectorAll('{_FOCUSABLE}')]).length")
    names = []
    for i in range(count):
        name = page.evaluate(
            f"(e => {{ e.focus(); return document.activeElement == e ? e.tagName + ' ' + e.className : '' }})(all[{i}])"
        )
        for key in ("Space", "Shift+Space") if name else ():
            pretender.stopped = 0.0
            page.keyboard.press(key)
            until(lambda: pretender.stopped, page, 10.0)
        names += [name] if name else []
    assert len(names) > 10
    assert {"BUTTON", "INPUT", "DIV"} <= {name.split()[0] for name in names}  # the panel's bar is a div
    pretender.stopped = 0.0
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("Space")
    until(lambda: pretender.stopped, page)
    assert teleop._recorder is None
    assert {order for order, _ in pretender.orders} <= {"hold"}
    assert page.evaluate(
        "[...document.querySelectorAll('button')].some(b => b.checkVisibility() && b.innerText == 'Record')"
    )
    assert page.errors == []


def test_the_button_stops_a_served_robot_and_is_confirmed(page, view, served):
    open_quiet(page, view.address)
    page.evaluate(f"{STOP}.click()")
    with lr.connect(served.address, name="another") as other:
        until(lambda: other.state.latched, page)
        page.wait_for_timeout(1000)
        assert not [said for _, shown, said in page.evaluate("window.seen") if "confirmed" in said and shown == "block"]
        assert not says(page)


def test_the_page_says_at_once_that_the_view_is_frozen_or_gone(page, view):
    open_quiet(page, view.address)
    view.process.send_signal(signal.SIGSTOP)
    assert seconds_until_it_says(page, "The view does not answer", time.time()) < limit(1.0)
    assert "red button" in says(page)
    view.process.send_signal(signal.SIGCONT)
    until(lambda: not says(page) and not is_off(page), page)
    view.process.kill()
    assert seconds_until_it_says(page, "The view does not answer", time.time()) < limit(1.0)


def test_the_page_says_at_once_that_the_robot_is_frozen_or_gone_and_a_stop_reaches_it_when_it_is_back(
    page, view, served
):
    open_quiet(page, view.address)
    served.process.send_signal(signal.SIGSTOP)
    assert seconds_until_it_says(page, "The robot has been silent for", time.time()) < limit(1.0)
    pressed = time.time()
    page.keyboard.press("Space")
    assert seconds_until_it_says(page, "The robot has not confirmed STOP", pressed) < limit(1.5)
    served.process.send_signal(signal.SIGCONT)
    with lr.connect(served.address, name="another") as other:
        until(lambda: other.state.latched, page)
        until(lambda: not says(page) and not is_off(page), page)
    served.process.kill()
    assert seconds_until_it_says(page, "The robot has been silent for", time.time()) < limit(1.0)
