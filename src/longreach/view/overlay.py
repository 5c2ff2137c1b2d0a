"""What lies over viser's page whatever its panel does: STOP, a banner, and a layout for narrow screens; and the pad.

viser's panel takes its buttons with it when somebody minimises it. STOP is therefore of the page itself: an HTML
element of the panel brings it along, once, with the script that is behind it.
"""

from collections.abc import Mapping
from html import escape
from importlib.resources import files
from typing import Any

from longreach.evaluation import style

_NARROW = "36em"  # below, viser has its panel at the bottom
_INSIDE = ".mantine-ScrollArea-root"  # of the panel at the bottom, of no other
_LAYOUT = f"""
@media (max-width: {_NARROW}) {{
  #root div:has(> .mantine-Paper-root > div > {_INSIDE}) {{ flex-direction: column; }}
  #root div:has(+ .mantine-Paper-root > div > {_INSIDE}) {{ height: auto !important; min-height: 0; }}
  #root .mantine-Paper-root:has(> div > {_INSIDE}) {{
    position: relative !important; flex: none; width: 100% !important; max-height: 38% !important; }}
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
#longreach-banner {{ display: none; position: fixed; z-index: 100000; left: 50%; top: 16px; transform: translateX(-50%);
  box-sizing: border-box; width: min(40rem, 100vw - 32px); padding: 1rem 1.25rem; border: 3px solid #fff;
  border-radius: 12px; background: #1c1e21; color: #fff; font: 400 1.1rem/1.35 system-ui, sans-serif;
  box-shadow: 0 2px 10px rgb(0 0 0 / .35); pointer-events: none; }}
#longreach-banner b {{ display: block; font-size: 1.5rem; margin-bottom: .2rem; }}
#longreach-stop:hover {{ filter: brightness(1.1); }}
#longreach-stop:active {{ filter: brightness(.75); }}
@media (max-width: {_NARROW}) {{
  #longreach-stop {{ left: auto; bottom: auto; right: 12px; top: 12px; width: 6.5rem; }}
  #longreach-stop small {{ display: none; }}
  #longreach-banner {{ top: 88px; width: calc(100vw - 24px); }}
}}
"""
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


def add_pad(server: Any, labels: Mapping[str, str]) -> None:
    """Add buttons that drive while they are held, three in a row; labels: of each, by its key."""
    buttons = "".join(f'<button type="button" data-drive="{key}">{label}</button>' for key, label in labels.items())
    server.gui.add_html(f'<style>{_PAD}</style><div class="longreach-pad">{buttons}</div>')


def _lasting(name: str, css: str, script: str) -> str:
    """Return a style that stays when the panel's elements go, and whose script runs once."""
    once = f"if (!document.getElementById('{name}')) {{ this.id = '{name}'; document.head.append(this);\n{script} }}"
    return f'<style onload="{escape(once)}">{css}</style>'
