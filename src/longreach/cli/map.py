"""longreach map: a map of where recordings went, with their loops closed and joined with each other."""

from pathlib import Path

import typer

from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_metrics


def command(
    recordings: list[Path] = typer.Argument(help=".bag, .mcap, ROS 2 folder, CARMEN log or text folder, with scans."),
    robot: str = typer.Option(..., help="A shipped description (thing, intel, fr079, …) or a YAML file."),
    out: Path = typer.Option(..., help="Folder for the results; made if it is not there."),
    add_to: Path | None = typer.Option(None, help="A map.lrmap to go on with; it is read, and not changed."),
    config: Path | None = typer.Option(None, help="YAML file that changes defaults."),
    truth: str | None = typer.Option(None, help="Reference: a topic of the recording, or a file (TUM, CARMEN, text)."),
    relations: Path | None = typer.Option(None, help="Relative reference poses: t1 t2 x y z roll pitch yaw a line."),
    sources: str | None = typer.Option(None, help="What to fuse, of wheels,lidar,imu (default: all there are)."),
) -> None:
    """Map recordings: optimised trajectories, a map, loop closures, metrics, figures and a report into a folder.

    Each recording is joined with the map that those before it make, or left out and named; the exit code is 1 then.
    """
    from longreach.app.inputs import open_run
    from longreach.app.map import build_map
    from longreach.app.map_outputs import write_map
    from longreach.app.warmup import warm_up
    from longreach.errors import ConfigError
    from longreach.io.whole_files import check_folder
    from longreach.mapping.map_file import load_map

    check_folder(out)
    if truth is not None and len(recordings) > 1 and Path(truth).exists():
        raise ConfigError(f"{truth} is the truth of one recording; map one at a time to compare with it.")
    with shown_progress() as progress:
        before = load_map(add_to) if add_to is not None else None
        options = {"config": config, "truth": truth, "relations": relations, "sources": sources, "progress": progress}
        runs = [open_run(recording, robot, **options) for recording in recordings]
        warm_up(progress, "estimation", "mapping")  # after what can be wrong with the files
        one = runs[0]
        built = build_map(
            [run.recording for run in runs], one.robot, one.config,
            add_to=before, truth=one.truth, relations=one.relations, progress=progress,
        )  # fmt: skip
        write_map(built, out, progress)
    print_metrics(built.metrics)
    for remark in built.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"Everything is in {out}; open {out / 'report.html'}.")
    if built.left_out:
        raise typer.Exit(1)
