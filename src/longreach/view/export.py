"""The scene of a run as one HTML page that plays by itself and fetches nothing."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from longreach.view.moment import Run
from longreach.view.page import open_page
from longreach.view.player import Player

_RATE = 10.0  # pictures a second of the run
_MOST = 400  # pictures


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
        server.stop()
