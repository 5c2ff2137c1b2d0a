"""longreach evaluate: how well an estimate agrees with a reference."""

from pathlib import Path

import typer

from longreach.cli.input_options import named_values
from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_metrics


def command(
    estimate: Path = typer.Argument(help="A trajectory (TUM, EuRoC, KITTI …), or the folder of an estimate."),
    truth: Path | None = typer.Option(None, help="Reference trajectory (TUM, EuRoC, KITTI, CARMEN or text)."),
    relations: Path | None = typer.Option(None, help="Relative reference poses: t1 t2 x y z roll pitch yaw a line."),
    assume: list[str] = typer.Option(
        [], help="What is known of the files: quaternion=xyzw|wxyz, axes=robot|camera|camera-body; may be repeated."
    ),
    out: Path = typer.Option(..., help="Folder for the results; made if it is not there."),
) -> None:
    """Compare trajectories with a reference and write metrics, figures and a report into a folder."""
    from longreach.app.evaluate import evaluate_files
    from longreach.app.outputs import write_evaluation
    from longreach.io.whole_files import check_folder

    check_folder(out)
    known = named_values("--assume", assume, "quaternion=wxyz")
    with shown_progress() as progress:
        result = evaluate_files(estimate, truth, relations, progress, known)
        write_evaluation(result, out, progress)
    print_metrics(result.metrics)
    for remark in result.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"Everything is in {out}; open {out / 'report.html'}.")
