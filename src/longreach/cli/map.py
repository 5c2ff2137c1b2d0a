"""longreach map: a map of where a recording went, with its loops closed."""

from pathlib import Path

import typer

from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_metrics


def command(
    recording: Path = typer.Argument(help="A .bag, .mcap, ROS 2 folder, CARMEN log or text folder, with scans."),
    robot: str = typer.Option(..., help="A shipped description (thing, intel, fr079, …) or a YAML file."),
    out: Path = typer.Option(..., help="Folder for the results; made if it is not there."),
    config: Path | None = typer.Option(None, help="YAML file that changes defaults."),
    truth: str | None = typer.Option(None, help="Reference: a topic of the recording, or a file (TUM, CARMEN, text)."),
    relations: Path | None = typer.Option(None, help="Relative reference poses: t1 t2 x y z roll pitch yaw a line."),
    sources: str | None = typer.Option(None, help="What to fuse, of wheels,lidar,imu (default: all there are)."),
) -> None:
    """Map a recording: optimised trajectory, map, loop closures, metrics, figures and a report into a folder."""
    from longreach.app.inputs import open_run
    from longreach.app.map import build_map, write_map
    from longreach.app.warmup import warm_up
    from longreach.io.whole_files import check_folder

    check_folder(out)
    with shown_progress() as progress:
        run = open_run(
            recording, robot, config=config, truth=truth, relations=relations, sources=sources, progress=progress
        )
        warm_up(progress, "estimation", "mapping")  # after what can be wrong with the files
        mapped = build_map(
            run.recording, run.robot, run.config, truth=run.truth, relations=run.relations, progress=progress
        )
        write_map(mapped, out, progress)
    print_metrics(mapped.metrics)
    for remark in mapped.evaluation.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"Everything is in {out}; open {out / 'report.html'}.")
