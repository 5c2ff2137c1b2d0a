"""longreach warmup: compile all kernels now, so that no later command has to."""

import typer

from longreach.cli.progress import shown_progress


def command() -> None:
    """Compile every kernel into the cache folder (the first run on a machine does it by itself)."""
    import time

    from longreach.app.warmup import warm_up

    began = time.perf_counter()
    with shown_progress() as progress:
        folder = warm_up(progress)
    typer.echo(f"All kernels are compiled ({time.perf_counter() - began:.1f} s); they are kept in {folder}.")
