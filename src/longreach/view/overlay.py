"""What lies over viser's page whatever its panel does: STOP, banners, notices, a layout for narrow screens; the pad.

viser's panel takes its buttons with it when somebody minimises it. STOP is therefore of the page itself: an HTML
element of the panel brings it along, once, with the script that is behind it. Notices are viser's.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any

from longreach.evaluation import style

_NARROW = "36em"  # below, viser has its panel at the bottom
_PANEL = "38%"  # of the height, that it may have there
_INSIDE = ".mantine-ScrollArea-root"  # of the panel at the bottom, of no other
_LAYOUT = f"""
@media (max-width: {_NARROW}) {{
  #root div:has(> .mantine-Paper-root > div > {_INSIDE}) {{ flex-direction: column; }}
  #root div:has(+ .mantine-Paper-root > div > {_INSIDE}) {{ height: auto !important; min-height: 0; }}
  #root .mantine-Paper-root:has(> div > {_INSIDE}) {{
    position: relative !important; flex: none; width: 100% !important; max-height: {_PANEL} !important; }}
  #root .mantine-ScrollArea-content > div {{ width: 100% !important; }}
}}
"""
_STOP = f"""
#longreach-stop {{ position: fixed; left: 16px; bottom: 16px; z-index: 100000; width: 8.5rem; height: 4rem;
  border: 3px solid #fff; border-radius: 12px; background: {style.VERMILION}; color: #fff; cursor: pointer;
  font: 700 1.5rem/1 system-ui, sans-serif; letter-spacing: .05em; box-shadow: 0 2px 10px rgb(0 0 0 / .35);
  touch-action: manipulation; user-select: none; }}
#longreach-stop small {{ display: block; margin-top: .25rem; font: 400 .75rem/1 system-ui, sans-serif; }}
#longreach-stop.longreach-off {{ background: #868e96; text-decoration: line-through; }}
#longreach-banner {{ display: none; position: fixed; z-index: 100000; left: calc(8.5rem + 32px); bottom: 16px;
  box-sizing: border-box; width: min(40rem, max(20rem, 100vw - 8.5rem - 26em)); padding: 1rem 1.25rem;
  border: 3px solid #fff; border-radius: 12px; background: #1c1e21; color: #fff; pointer-events: none;
  font: 400 1.1rem/1.35 system-ui, sans-serif; box-shadow: 0 2px 10px rgb(0 0 0 / .35); }}
#longreach-banner b {{ display: block; font-size: 1.5rem; margin-bottom: .2rem; }}
#longreach-stop:hover {{ filter: brightness(1.1); }}
#longreach-stop:active {{ filter: brightness(.75); }}
@media (max-width: {_NARROW}) {{
  #longreach-stop {{ left: auto; bottom: auto; right: 12px; top: 12px; width: 6.5rem; }}
  #longreach-stop small {{ display: none; }}
  #longreach-banner {{ left: 12px; bottom: calc({_PANEL} + 12px); width: calc(100vw - 24px); padding: .6rem .9rem;
    font-size: 1rem; }}
  #longreach-banner b {{ font-size: 1.2rem; }}
}}
"""
_BANNER_COLOUR = (178, 34, 34)  # of nothing else in the page
_BANNER = f".mantine-Notification-root[style*='#{bytes(_BANNER_COLOUR).hex()}']"  # a notification of that colour
_NOTICES = f"""
.mantine-Notifications-root {{ --notifications-container-width: min(34em, 100vw - 23em) !important; }}
.mantine-Notifications-root > div {{ display: flex; flex-direction: column; }}
.mantine-Notification-root {{ max-width: 20em; }}
{_BANNER} {{ order: -1; max-width: none; max-height: none !important; pointer-events: none !important;
  padding: 1em 1.3em; background: rgb{_BANNER_COLOUR}; }}
{_BANNER}::before {{ display: none; }}
{_BANNER} .mantine-Notification-title {{ color: #fff; font: 700 1.4rem/1.25 system-ui, sans-serif; }}
{_BANNER} .mantine-Notification-description {{ color: #fff; font-size: 1rem; }}
@media (max-width: {_NARROW}) {{
  .mantine-Notifications-root {{ --notifications-container-width: calc(100vw - 6.5rem - 3em) !important; }}
  {_BANNER} {{ padding: .5em .8em; }}
  {_BANNER} .mantine-Notification-title {{ font-size: 1.05rem; }}
  {_BANNER} .mantine-Notification-description {{ font-size: .85rem; }}
}}
"""
_LASTS = 8.0  # a notice, after it was given last [s]
_PAD = """
.longreach-pad { display: grid; grid-template-columns: repeat(3, 1fr); gap: .4em; padding: .2em .6em; }
.longreach-pad button { height: 2.2rem; border: 1px solid #ced4da; border-radius: 4px; background: #f1f3f5;
  color: #212529; font: 600 .9rem/1 system-ui, sans-serif; cursor: pointer; touch-action: none; user-select: none;
  -webkit-user-select: none; -webkit-touch-callout: none; }
.longreach-pad button:active { background: #ced4da; }
"""
# viser's client adds the websocket's address to the page's, which has a path; it is the same without.
_PLAIN_ADDRESS = "history.replaceState(null, '', location.pathname);"


def add_layout(server: Any) -> None:
    """Let the scene have most of a narrow screen, whatever is in the panel."""
    server.gui.add_html(_lasting("longreach-layout", _LAYOUT, _PLAIN_ADDRESS))


def add_stop(server: Any) -> None:
    """Add STOP, the banner that says when it cannot reach the robot, and what hears keys and the pad's buttons."""
    script = files("longreach.view").joinpath("control.js").read_text(encoding="utf-8")
    server.gui.add_html(_lasting("longreach-stop-style", _STOP, script))


@dataclass
class _Notice:
    """A title and a sentence, how often they were given, and until when they are shown by time.monotonic() [s]."""

    title: str
    body: str
    count: int
    until: float


class Notices:
    """Notices over the scene of each browser, the same one once, and a banner that stays as long as it is given."""

    def __init__(self, server: Any) -> None:
        self._server = server
        self._given: dict[str, _Notice] = {}
        self._shown: dict[tuple[str, int], Any] = {}  # by notice and browser
        server.gui.add_html(_lasting("longreach-notices", _NOTICES))

    def tell(self, title: str, body: str) -> None:
        """Give a notice, from any thread; one that is still shown is counted."""
        before = self._given.get(title + body)
        self._given[title + body] = _Notice(title, body, before.count + 1 if before else 1, time.monotonic() + _LASTS)

    def show(self, banner: tuple[str, str] | None = None) -> None:
        """Bring every browser up to date; banner: title and sentence, or None where there is none."""
        now, browsers = time.monotonic(), self._server.get_clients()
        wanted = {} if banner is None else {"": banner}
        for key, notice in list(self._given.items()):
            if now > notice.until:
                self._given.pop(key, None)
                continue
            times = f" ({notice.count} times)" if notice.count > 1 else ""
            wanted[key] = (notice.title, notice.body + times)
        for key, browser in [where for where in self._shown if where[0] not in wanted or where[1] not in browsers]:
            handle = self._shown.pop((key, browser))
            if browser in browsers:
                handle.remove()
        for key, (title, body) in wanted.items():
            for number, browser in browsers.items():
                handle = self._shown.get((key, number))
                if handle is None:
                    self._shown[key, number] = browser.add_notification(
                        title, body, with_close_button=bool(key), color=None if key else _BANNER_COLOUR
                    )
                elif (handle.title, handle.body) != (title, body):
                    handle.title, handle.body = title, body


def add_pad(server: Any, labels: Mapping[str, str]) -> None:
    """Add buttons that drive while they are held, three in a row; labels: of each, by its key."""
    buttons = "".join(f'<button type="button" data-drive="{key}">{label}</button>' for key, label in labels.items())
    server.gui.add_html(f'<style>{_PAD}</style><div class="longreach-pad">{buttons}</div>')


def _lasting(name: str, css: str, script: str = "") -> str:
    """Return a style that stays when the panel's elements go, and whose script runs once."""
    once = f"if (!document.getElementById('{name}')) {{ this.id = '{name}'; document.head.append(this);\n{script} }}"
    return f'<style onload="{escape(once)}">{css}</style>'
