"""The scene of a run as one HTML page that plays by itself and fetches nothing."""

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

from longreach.io.whole_files import write_text
from longreach.view.moment import Run
from longreach.view.page import close_page, open_page
from longreach.view.player import Player
from longreach.view.replay import read_run

_RATE = 10.0  # pictures a second of the run
_MOST = 400  # pictures
_FRAME = "display:block;width:100%;height:28rem;border:1px solid var(--line);border-radius:6px"


def page_html(run: Run) -> str:
    """Return the page: viser's client and the run's messages, both inside."""
    with _closed() as server:
        player = Player(server, run, panel=False)
        serializer = server.get_scene_serializer()
        count = max(2, min(_MOST, round(run.duration * _RATE)))
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


def add_to_report(folder: Path) -> bool:
    """Put the scene of a run's folder into its report.html, before the figures; return whether that was done.

    The scene is a page of its own in a frame, inside the file; it loads when it is scrolled to.
    """
    report = folder / "report.html"
    needed = (report, folder / "recording.mcap", folder / "fused.tum")
    if importlib.util.find_spec("viser") is None or not all(file.is_file() for file in needed):
        return False
    scene = escape(page_html(read_run(folder)), quote=True)
    frame = f'<iframe title="The run" loading="lazy" style="{_FRAME}" srcdoc="{scene}"></iframe>'
    said = "The run, played over and over. Drag to turn it, scroll to come nearer."
    section = f"<section><h2>Scene</h2>\n<figure>{frame}<figcaption>{said}</figcaption></figure>\n</section>\n"
    page = report.read_text(encoding="utf-8")
    at = page.find("<section><h2>Figures")
    if at < 0:
        return False
    write_text(report, page[:at] + section + page[at:])
    return True
