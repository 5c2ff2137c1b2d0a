"""The page itself: a viser server on this machine, its look, its legend and its plots."""

import io
from collections.abc import Sequence
from contextlib import redirect_stdout
from html import escape
from typing import Any

import numpy as np

from longreach.view import overlay
from longreach.view.frame import Plot
from longreach.view.gate import Gate, guarded
from longreach.view.scene import COLOURS, engine

_LONGEST = 300  # letters of a text from elsewhere
_NAMES = {
    "estimate": "estimate: the robot, and the ellipse that the base is in with 95 %",
    "wheels": "base by its wheels alone, as an outline",
    "truth": "truth: the base as an outline, the tool as a ball",
    "scan": "newest scan",
    "map": "map of all scans",
    "base driven": "base, driven",
    "tool driven": "tool, driven",
    "base planned": "base, planned",
    "tool planned": "tool, planned",
}


def open_page(host: str = "127.0.0.1", port: int = 8080) -> Any:
    """Start a viser server, without anything in it but its look; its `gate` says who may speak to it, and its address.

    Raises:
        ConfigError: viser is not installed, or a version of it that strangers could speak to.
    """
    viser, gate = engine(), Gate()
    with guarded(gate), redirect_stdout(io.StringIO()):  # it has a banner of its own
        gate.server = server = viser.ViserServer(host=host, port=port, label="longreach", verbose=False)
    server.gate = gate
    server.gui.configure_theme(
        show_logo=False, show_share_button=False, control_width="medium", brand_color=(0, 114, 178)
    )
    server.gui.set_panel_label("longreach")
    overlay.add_layout(server)
    _add_lights(server.scene)
    return server


def _add_lights(scene: Any) -> None:
    """Light the scene by lamps: viser's picture of surroundings takes a software renderer five seconds to prepare."""
    scene.configure_environment_map(hdri=None)
    above = {"sky_color": (255, 255, 255), "ground_color": (120, 124, 130), "intensity": 2.0}
    scene.add_light_hemisphere("/sky", position=(0.0, 0.0, 1.0), **above)
    scene.add_light_directional("/window", position=(-2.0, 0.5, 1.0), intensity=0.7, cast_shadow=False)


def close_page(server: Any) -> None:
    """End a page's server."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def text_html(words: str) -> str:
    """Return words that may come from anybody as HTML that shows them, and does nothing else.

    All such words come into the page here, or as a notification or label, which viser shows as text. They never go into
    viser's markdown, which takes HTML and fetches pictures.
    """
    return escape(" ".join(words.split())[:_LONGEST])


def legend_html(shown: Sequence[str]) -> str:
    """Return what the colours mean, and the units."""
    rows = "".join(
        f'<div style="display:flex;align-items:center;gap:.5em;line-height:1.6">'
        f'<span style="flex:none;width:1.1em;height:.55em;border-radius:2px;background:{COLOURS[name]}"></span>'
        f"{_NAMES[name]}</div>"
        for name in shown
    )
    return rows + '<div style="opacity:.65;margin-top:.3em">A square of the floor is 0.5 m.</div>'


def add_legend(server: Any, shown: Sequence[str]) -> None:
    """Add what the colours mean, and the units."""
    server.gui.add_html(f'<div style="font-size:.8em;padding:.2em .6em">{legend_html(shown)}</div>')


class PlotPanel:
    """One plot in the panel; its axes stay where they are while its lines grow."""

    def __init__(self, server: Any, plot: Plot, times: np.ndarray, visible: bool = True) -> None:
        self._plot, self._times = plot, times
        grid = {"show": True, "stroke": "#e6e8eb", "width": 1}
        names = [{"label": "t [s]"}]
        names += [{"label": c.name, "stroke": c.colour, "width": 1.6, "points": {"show": False}} for c in plot.curves]
        server.gui.add_html(
            f'<div style="font-size:.8em;font-weight:600;padding:.3em .6em 0">{text_html(plot.title)}</div>'
        )
        span = (float(times[0]), float(times[-1]))
        self._handle = server.gui.add_uplot(
            self._data(len(times)), tuple(names), height=150, visible=visible,
            scales={
                "x": {"time": False, "auto": False, "range": span},
                "y": {"auto": False, "range": (plot.lowest, plot.highest)},
            },
            axes=({"grid": grid, "size": 28}, {"grid": grid, "size": 44}),
            legend={"show": len(plot.curves) > 1, "live": False},
            padding=(8, 10, 0, 0),
        )  # fmt: skip

    def _data(self, count: int) -> tuple[np.ndarray, ...]:
        step = max(1, len(self._times) // 600)
        rows = np.arange(0, max(count, 2), step)
        rows = rows if rows[-1] == count - 1 else np.append(rows, max(count, 2) - 1)
        return (self._times[rows], *(c.values[rows] for c in self._plot.curves))

    def show(self, count: int) -> None:
        """Show the first rows."""
        self._handle.data = self._data(count)
