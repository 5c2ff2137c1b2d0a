"""longreach run: an experiment of the thesis, simulated with physics."""

from pathlib import Path

import typer

from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_table


def command(
    experiment: str = typer.Argument(help="localization."),
    out: Path | None = typer.Option(None, help="Folder for the results (default: out/EXPERIMENT)."),
    seed: int = typer.Option(0, help="Seed of everything random."),
    seeds: int = typer.Option(1, help="How many runs, with seeds counted on from the first, on all cores."),
    duration: float = typer.Option(120.0, help="Length of the drive in seconds."),
    floor: str = typer.Option("good", help="good, worn, wet, slippery, or a coefficient of friction."),
) -> None:
    """Run a simulated experiment and write recording, trajectories, figures and a report into a folder."""
    from longreach.app.localization import LocalizationConfig, run_localization
    from longreach.app.warmup import warm_up
    from longreach.errors import ConfigError
    from longreach.evaluation.tables import main_metrics, metric_table
    from longreach.io.config import validated

    if experiment != "localization":
        raise ConfigError(f"There is no experiment {experiment!r}; there is localization.")
    number = floor.replace(".", "", 1).isdigit()
    settings = {"seed": seed, "seeds": seeds, "duration": duration, "floor": float(floor) if number else floor}
    config = validated(LocalizationConfig, settings, "the options")
    folder = out or Path("out") / experiment
    with shown_progress() as progress:
        warm_up(progress, "estimation")
        metrics = run_localization(config, folder, progress)
    table = metric_table(metrics if seeds > 1 else main_metrics(metrics))
    print_table(table.header, table.rows)
    typer.echo(f"Everything is in {folder}; open {folder / 'report.html'}.")
