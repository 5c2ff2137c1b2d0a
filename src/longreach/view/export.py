"""The scene of a run as one HTML page that plays by itself and fetches nothing, with its legend and its plots."""

import base64
import importlib.util
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

from longreach.io.whole_files import write_text
from longreach.view import plot_figure
from longreach.view.frame import Run
from longreach.view.page import close_page, legend_html, open_page
from longreach.view.player import Player
from longreach.view.replay import read_run

_RATE = 10.0  # pictures a second of the run
_MOST = 400  # pictures
_FRAME = "display:block;width:100%;height:28rem;border:1px solid #d9dce0;border-radius:6px"
_SAID = "The run, played over and over. Drag to turn it, scroll to come nearer."
_STYLE = """
body { margin: 0 auto; padding: 1rem 1.25rem 3rem; max-width: 72rem; color: #1c1e21; background: #fff;
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.4rem; margin: .2rem 0 .8rem; overflow-wrap: anywhere; }
figure { margin: 0 0 1.6rem; } figure iframe { height: 70vh !important; min-height: 20rem; }
figure img { display: block; width: 100%; max-width: 60rem; height: auto; }
figcaption { margin-top: .6rem; color: #5b6169; font-size: .92rem; }
"""


def scene_html(run: Run) -> str:
    """Return viser's client with the run's messages inside: the scene alone."""
    with _closed() as server:
        player = Player(server, run, panel=False)
        serializer = server.get_scene_serializer()
        count = max(2, min(_MOST, len(run.frames), round(run.duration * _RATE)))
        for i in range(count):
            player.seek(run.duration * i / (count - 1))
            serializer.insert_sleep(run.duration / count)
        return serializer.as_html()


@contextmanager
def _closed() -> Iterator[Any]:
    server = open_page(port=0)
    try:
        yield server
    finally:
        close_page(server)


def page_html(run: Run) -> str:
    """Return a page of the scene, what its colours mean, and the run's plots."""
    title = escape(run.name)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<h1>{title}, {run.duration:.1f} s</h1>\n"
        f"{_figures(run, plots=True)}</body>\n</html>\n"
    )


def _figures(run: Run, plots: bool) -> str:
    """Return the scene in a frame of its own, inside the file, which loads when it is scrolled to, and the plots."""
    scene = escape(scene_html(run), quote=True)
    frame = f'<iframe title="The run" loading="lazy" style="{_FRAME}" srcdoc="{scene}"></iframe>'
    legend = f'<div style="columns:20rem 2">{legend_html(run.shown)}</div>'
    figures = f"<figure>{frame}<figcaption>{legend}<p>{_SAID}</p></figcaption></figure>\n"
    if plots and run.plots:
        data = base64.b64encode(plot_figure.svg(run)).decode("ascii")
        titles = escape("; ".join(plot.title for plot in run.plots))
        figures += f'<figure><img alt="{titles}" src="data:image/svg+xml;base64,{data}"></figure>\n'
    return figures


def add_to_report(folder: Path, run: Callable[[], Run] | None = None) -> bool:
    """Put the scene of a run into its folder's report.html, before the figures; return whether that was done.

    run: returns what is shown, without plots; None reads the folder, which must then hold the recording.
    """
    report = folder / "report.html"
    needed = (report,) if run is not None else (report, folder / "recording.mcap", folder / "fused.tum")
    if importlib.util.find_spec("viser") is None or not all(file.is_file() for file in needed):
        return False
    page = report.read_text(encoding="utf-8")
    at = page.find("<section><h2>Figures")
    if at < 0:
        return False
    figures = _figures(read_run(folder), plots=True) if run is None else _figures(run(), plots=False)
    section = f"<section><h2>Scene</h2>\n{figures}</section>\n"
    write_text(report, page[:at] + section + page[at:])
    return True
