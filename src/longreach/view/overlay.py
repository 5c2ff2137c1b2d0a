"""What lies over viser's page whatever its panel does: a stop button, and a layout for narrow screens.

viser's panel takes its buttons with it when somebody minimises it, and its keys are dead while a field has the focus.
The stop is therefore of the page itself: an HTML element of the panel brings it along, once.
"""

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
div:has(> .longreach-pad) ~ div {{ display: inline-block; width: calc(33.3% - .8em);
  margin: 0 .4em !important; }}
"""
_STOP = f"""
#longreach-stop {{ position: fixed; left: 16px; bottom: 16px; z-index: 100000; width: 8.5rem; height: 4rem;
  border: 3px solid #fff; border-radius: 12px; background: {style.VERMILION}; color: #fff; cursor: pointer;
  font: 700 1.5rem/1 system-ui, sans-serif; letter-spacing: .05em; box-shadow: 0 2px 10px rgb(0 0 0 / .35);
  touch-action: manipulation; user-select: none; }}
#longreach-stop small {{ display: block; margin-top: .25rem; font: 400 .75rem/1 system-ui, sans-serif; }}
#longreach-stop:hover {{ filter: brightness(1.1); }}
#longreach-stop:active {{ filter: brightness(.75); }}
@media (max-width: {_NARROW}) {{
  #longreach-stop {{ left: auto; bottom: auto; right: 12px; top: 12px; width: 6.5rem; }}
  #longreach-stop small {{ display: none; }}
}}
"""
# A touch counts when it begins. The space bar is the hotkey of the command "Stop"; in fields viser would not hear it.
_SCRIPT = """
const b = document.createElement('button');
b.id = 'longreach-stop'; b.type = 'button'; b.title = 'Brake at once and stay so';
b.innerHTML = 'STOP<small>space bar</small>';
const stop = () => document.documentElement.dispatchEvent(
  new KeyboardEvent('keydown', { key: ' ', code: 'Space', bubbles: true }));
b.addEventListener('pointerdown', stop);
b.addEventListener('click', stop);
document.body.append(b);
window.addEventListener('keydown', e => {
  if (e.isTrusted && e.code === 'Space' && e.target.matches('input, textarea, select, button')) {
    e.preventDefault(); e.stopImmediatePropagation(); stop();
  }
}, true);
"""


def add_layout(server: Any) -> None:
    """Let the scene have most of a narrow screen, whatever is in the panel."""
    server.gui.add_html(_lasting("longreach-layout", _LAYOUT))


def add_stop(server: Any) -> None:
    """Add the stop button; it triggers the command that has the space bar as its hotkey."""
    server.gui.add_html(_lasting("longreach-stop-style", _STOP, _SCRIPT))


def add_pad(server: Any) -> None:
    """Let the buttons that follow in a folder stand three in a row."""
    server.gui.add_html('<span class="longreach-pad"></span>')


def _lasting(name: str, css: str, script: str = "") -> str:
    """Return a style that stays when the panel's elements go, and whose script runs once."""
    kept = f"this.id = '{name}'; document.head.append(this); {script}"
    return f"<style onload=\"if (!document.getElementById('{name}')) {{ {kept} }}\">{css}</style>"
