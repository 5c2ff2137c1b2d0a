"""longreach estimate: where the base went, from its wheels, its LIDAR, its IMU and all of them fused."""

from pathlib import Path

import typer

from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_metrics, print_table


def command(
    recording: Path = typer.Argument(help="A .bag, .mcap, ROS 2 folder, CARMEN log or text folder."),
    robot: str | None = typer.Option(
        None,
        help="A shipped description (thing, intel, aces, polimi, …) or a YAML file; needed unless --config has it.",
    ),
    out: Path = typer.Option(..., help="Folder for the results; made if it is not there."),
    config: Path | None = typer.Option(
        None, help="YAML file that changes defaults; or a parameter file of robot_localization, which is then followed."
    ),
    truth: str | None = typer.Option(None, help="Reference: a topic of the recording, or a file (TUM, CARMEN, text)."),
    relations: Path | None = typer.Option(None, help="Relative reference poses: t1 t2 x y z roll pitch yaw a line."),
    sources: str | None = typer.Option(None, help="What to fuse, of wheels,lidar,imu,fixes (default: all there are)."),
    fixes: Path | None = typer.Option(None, help="Absolute positions to fuse as a GPS-like source (TUM or CARMEN)."),
    fix_sigma: float = typer.Option(0.05, help="Standard deviation of such a position in x and y, in metres."),
    fix_period: float = typer.Option(0.0, help="Use no more than one such position in so many seconds."),
    node: str | None = typer.Option(None, help="Node of a parameter file that has several."),
    filter: str | None = typer.Option(None, help="ekf or ukf, with a parameter file; default: as its node is named."),
    transform: list[str] = typer.Option(
        [], help="PARENT:CHILD=x,y,z,roll,pitch,yaw with a parameter file; repeatable."
    ),
    as_robot_localization: bool = typer.Option(
        False, "--as-robot-localization", help="With a parameter file: take over the known defects, to compare numbers."
    ),
) -> None:
    """Estimate a recording and write trajectories, covariances, metrics, figures and a report into a folder."""
    from longreach.errors import ConfigError
    from longreach.io.robot_localization import is_parameter_file

    if config is not None and is_parameter_file(config):
        beside = {"--robot": robot, "--truth": truth, "--relations": relations, "--sources": sources, "--fixes": fixes}
        given = [name for name, value in beside.items() if value is not None]
        if given:
            raise ConfigError(f"{config} is for robot_localization, beside which {', '.join(given)} cannot be given.")
        _in_space(recording, config, out, node, filter, transform, as_robot_localization)
        return
    if node or filter or transform or as_robot_localization:
        raise ConfigError(
            "--node, --filter, --transform and --as-robot-localization go with a parameter file of robot_localization "
            "as --config."
        )
    if robot is None:
        raise ConfigError("Give --robot, a shipped description or a YAML file; or --config for robot_localization.")
    from longreach.app.estimate import estimate
    from longreach.app.inputs import open_run
    from longreach.app.outputs import write_estimate
    from longreach.app.warmup import warm_up
    from longreach.io.whole_files import check_folder

    check_folder(out)
    with shown_progress() as progress:
        run = open_run(
            recording,
            robot,
            config=config,
            truth=truth,
            relations=relations,
            sources=sources,
            fixes=fixes,
            fix_sigma=fix_sigma,
            fix_period=fix_period,
            progress=progress,
        )
        warm_up(progress, "estimation")  # after what can be wrong with the files
        result = estimate(
            run.recording, run.robot, run.config, truth=run.truth, relations=run.relations, progress=progress
        )
        write_estimate(result, out, progress)
    print_metrics(result.metrics)
    for remark in result.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"Everything is in {out}; open {out / 'report.html'}.")


def _in_space(
    recording: Path,
    parameters: Path,
    out: Path,
    node: str | None,
    filter: str | None,
    transforms: list[str],
    as_robot_localization: bool,
) -> None:
    """Follow a parameter file of robot_localization."""
    from longreach.app.spatial_estimate import estimate_from_parameters, write_spatial_run
    from longreach.evaluation.tables import metric_table
    from longreach.io.whole_files import check_folder

    check_folder(out)
    with shown_progress() as progress:
        run = estimate_from_parameters(
            recording,
            parameters,
            node=node,
            filter=filter,
            transforms=transforms,
            as_robot_localization=as_robot_localization,
            progress=progress,
        )
        write_spatial_run(run, out, progress)
    table = metric_table(run.main)
    print_table(table.header, table.rows)
    for remark in run.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"Everything is in {out}; open {out / 'report.html'}.")
