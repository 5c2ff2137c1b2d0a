"""longreach run: an experiment of the thesis, simulated with physics."""

from pathlib import Path

import typer

from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_table


def command(
    experiment: str = typer.Argument(help="localization, dual-trajectory or manipulability."),
    out: Path | None = typer.Option(None, help="Folder for the results (default: out/EXPERIMENT)."),
    seed: int = typer.Option(0, help="Seed of everything random."),
    seeds: int = typer.Option(1, help="How many runs, with seeds counted on from the first, on all cores."),
    duration: float | None = typer.Option(None, help="localization: length of the drive in seconds; 120."),
    length: float | None = typer.Option(None, help="dual-trajectory: of the tool's line in metres; 2."),
    objective: str | None = typer.Option(None, help="manipulability: sqrt_kappa_over_m (4.33), or neg_log_m."),
    world: str | None = typer.Option(None, help="laboratory, building, storehouse, twins, office, …, or a YAML file."),
    video: bool = typer.Option(False, "--video", help="Write a film of the run, drive.gif."),
    view: bool = typer.Option(False, "--view", help="Show the run in a window, where there is a screen."),
    floor: str | None = typer.Option(None, help="good, worn, wet, slippery, or a coefficient of friction."),
) -> None:
    """Run a simulated experiment and write recording, trajectories, figures and a report into a folder."""
    from longreach.app.experiments import EXPERIMENTS
    from longreach.app.warmup import warm_up
    from longreach.errors import ConfigError
    from longreach.evaluation.tables import failures, metric_table
    from longreach.io.config import validated
    from longreach.io.whole_files import check_folder
    from longreach.sim.worlds import friction_of, load_world
    from longreach.view.export import add_to_report

    if experiment not in EXPERIMENTS:
        raise ConfigError(f"There is no experiment {experiment!r}; there are {', '.join(EXPERIMENTS)}.")
    chosen = EXPERIMENTS[experiment]
    given = {
        "duration": duration,
        "length": length,
        "objective": objective,
        "world": world,
        "floor": floor,
        "video": video,
        "view": view,
    }
    given = {name: value for name, value in given.items() if value is not None}
    config = validated(chosen.config, {"seed": seed, "seeds": seeds, **given}, "the options")
    folder = out or Path("out") / experiment
    check_folder(folder)
    if world is not None:
        load_world(world)
    if "floor" in given:
        friction_of(given["floor"])
    with shown_progress() as progress:
        warm_up(progress, *chosen.rooms)
        metrics = chosen.run(config, folder, progress)
        progress("scene for the report", 0.0)
        add_to_report(folder)
    failed = failures(metrics)
    for failure in failed:
        typer.echo(failure)
    table = metric_table(chosen.main(metrics))
    print_table(table.header, table.rows)
    typer.echo(chosen.verdict(metrics))
    typer.echo(f"Everything is in {folder}; open {folder / 'report.html'}.")
    if failed:
        raise typer.Exit(1)
