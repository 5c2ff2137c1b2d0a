"""Parts of the page, and how to wait for it, in a browser."""

import time

STOP = "document.getElementById('longreach-stop')"
CANVAS = "document.querySelector('canvas[data-engine]')"


def box(page, element):
    """Left, top, right and bottom; asked of the page itself, for playwright waits for pictures."""
    return page.evaluate(f"(b => [b.left, b.top, b.right, b.bottom])({element}.getBoundingClientRect())")


def until(condition, page, limit=30.0):
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        page.wait_for_timeout(20)


def press(page, words):
    """Press the button with these words in the panel."""
    find = f"[...document.querySelectorAll('button')].find(b => b.innerText.startsWith('{words}'))"
    until(lambda: page.evaluate(f"!!{find} && !{find}.disabled"), page)
    page.evaluate(f"{find}.click()")
