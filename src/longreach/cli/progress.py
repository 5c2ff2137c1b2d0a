"""The log and progress on standard error: a bar a stage on a terminal, else the names of the stages alone."""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def show_log() -> None:
    """Show what the package logs on standard error; by a handler of its own, for rospy takes away those of others."""
    handler, log = logging.StreamHandler(sys.stderr), logging.getLogger("longreach")
    handler.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)


@contextmanager
def shown_progress() -> Iterator[Callable[[str, float], None]]:
    """Yield a function that shows how far a named stage is, from 0 to 1."""
    if not sys.stderr.isatty():
        seen: set[str] = set()

        def tell(stage: str, fraction: float) -> None:
            if stage not in seen:
                seen.add(stage)
                print(f"{stage} …", file=sys.stderr, flush=True)

        yield tell
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<34}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, object] = {}

        def show(stage: str, fraction: float) -> None:
            if stage not in tasks:
                for earlier in tasks.values():
                    bars.update(earlier, completed=1.0)  # type: ignore[arg-type]
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=min(max(fraction, 0.0), 1.0))  # type: ignore[arg-type]

        yield show
        for task in tasks.values():
            bars.update(task, completed=1.0)  # type: ignore[arg-type]
