"""longreach demo: make a recording of a driving robot, estimate it, and compare with the truth."""

from pathlib import Path

import typer

from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_metrics


def command(
    out: Path = typer.Option(Path("out/demo"), help="Folder for the results; made if it is not there."),
    seed: int = typer.Option(0, help="Seed of everything random."),
    duration: float = typer.Option(60.0, min=1.0, help="Length of the drive in seconds."),
) -> None:
    """Drive a made mecanum base through a room, write the recording, and estimate it as any other."""
    from longreach.app.demo import make_and_estimate

    with shown_progress() as progress:
        result = make_and_estimate(out, seed, duration, progress)
    print_metrics(result.metrics)
    typer.echo(f"Everything is in {out}; open {out / 'report.html'}.")
