"""longreach calibrate: wheels and the laser's pose from ordinary driving, and what the recordings do not show."""

from pathlib import Path

import typer

from longreach.cli import input_options
from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_table


def command(
    recordings: list[Path] = typer.Argument(help="One recording of ordinary driving, or several of the same robot."),
    robot: str = typer.Option(..., help="A shipped description (thing, polimi, …) or a YAML file: the nominal one."),
    out: Path = typer.Option(..., help="Folder for the results; made if it is not there."),
    truth: str | None = typer.Option(
        None, help="Take motions from a reference in place of scans: a topic of the recordings, or a file for one."
    ),
    assume: list[str] = input_options.ASSUME,
) -> None:
    """Calibrate a robot and write its description to use from now on, with σ for each number, into a folder."""
    from longreach.app.calibrate import calibrate, is_changed, write_calibration
    from longreach.app.inputs import open_run
    from longreach.app.warmup import warm_up
    from longreach.errors import ConfigError
    from longreach.io.whole_files import check_folder

    check_folder(out)
    if truth is not None and Path(truth).exists() and len(recordings) > 1:
        raise ConfigError(f"{truth} is the reference of one recording; give a topic, or one recording.")
    with shown_progress() as progress:
        assumed = input_options.named_values("--assume", assume, "lidar.mount.yaw=3.14")
        runs = [open_run(path, robot, truth=truth, assume=assumed, progress=progress) for path in recordings]
        warm_up(progress, "estimation")  # after what can be wrong with the files
        result = calibrate(
            [run.recording for run in runs],
            runs[0].robot,
            truth=runs[0].truth,
            use_truth=truth is not None,
            progress=progress,
        )
        write_calibration(result, out, progress)
    rows = [
        (
            name,
            p.unit,
            f"{p.nominal:.6g}",
            f"{p.value:.6g}",
            "–" if p.sigma is None else f"{p.sigma:.2g}",
            "changed" if is_changed(p) else "" if p.observable else "not observable",
        )
        for name, p in result.parameters.items()
    ]
    print_table(("parameter", "unit", "nominal", "value", "σ", ""), rows)
    for remark in result.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"Use {out / 'robot.yaml'} from now on; {out / 'report.html'} says how it was found.")
