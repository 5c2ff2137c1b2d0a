"""longreach estimate: where the base went, from its wheels, its LIDAR, its IMU and all of them fused."""

from pathlib import Path
from typing import Any

import typer

from longreach.cli import estimate_in_space, input_options
from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_metrics


def command(
    recording: Path = typer.Argument(help="A .bag, .mcap, ROS 2 folder, CARMEN log or text folder."),
    robot: str | None = typer.Option(
        None, help="A shipped description (thing, intel, fr079, polimi, …) or a YAML file."
    ),
    out: Path = typer.Option(..., help="Folder for the results; made if it is not there."),
    config: Path | None = typer.Option(
        None, help="YAML file that changes defaults; or robot_localization's parameters, which need no --robot."
    ),
    truth: str | None = typer.Option(None, help="Reference: a topic of the recording, or a file (TUM, CARMEN, text)."),
    relations: Path | None = typer.Option(None, help="Relative reference poses: t1 t2 x y z roll pitch yaw a line."),
    sources: str | None = typer.Option(None, help="What to fuse, of wheels,lidar,imu,fixes (default: all there are)."),
    fixes: Path | None = typer.Option(None, help="Absolute positions to fuse as a GPS-like source (TUM or CARMEN)."),
    fix_sigma: float = typer.Option(0.05, help="Standard deviation of such a position in x and y, in metres."),
    fix_period: float = typer.Option(0.0, help="Use no more than one such position in so many seconds."),
    map_: Path | None = typer.Option(None, "--map", help="A map.lrmap, or a map_server's map.yaml, to localise in."),
    start: str | None = typer.Option(
        None, help="Where on the map: x,y,theta[,sx,sy,stheta] (metres, radians), or global (default): searched for."
    ),
    compare: bool = typer.Option(False, "--compare", help="LIDAR odometry alone as well: lidar.tum."),
    assume: list[str] = input_options.ASSUME,
    smooth: bool = typer.Option(False, "--smooth", help="Look back over the whole run as well: smoothed.tum."),
    topic: list[str] = input_options.TOPIC,
    clock: input_options.Clock = input_options.CLOCK,
    node: str | None = estimate_in_space.NODE,
    filter: str | None = estimate_in_space.FILTER,
    transform: list[str] = estimate_in_space.TRANSFORM,
    as_robot_localization: bool = estimate_in_space.AS_ROBOT_LOCALIZATION,
) -> None:
    """Estimate a recording and write trajectories, covariances, metrics, figures and a report into a folder."""
    planar: dict[str, Any] = {
        "robot": robot,
        "truth": truth,
        "relations": relations,
        "sources": sources,
        "fixes": fixes,
    }
    planar |= {
        "assume": assume or None,
        "topic": topic or None,
        "clock": None if clock is input_options.Clock.header else clock,
        "map": map_,
        "start": start,
    }
    spatial = {"node": node, "filter": filter, "transforms": transform}
    spatial["as_robot_localization"] = as_robot_localization
    if estimate_in_space.is_meant(config, planar, spatial):
        estimate_in_space.run(recording, config, out, spatial)
    else:
        settings = {
            "config": config,
            "fix_sigma": fix_sigma,
            "fix_period": fix_period,
            "smooth": smooth,
            "compare": compare,
            "assume": input_options.named_values("--assume", planar.pop("assume") or (), "lidar.mount.yaw=3.14"),
            "topics": input_options.named_values("--topic", planar.pop("topic") or (), "lidar=/scan"),
            "clock": clock.value,
        }
        _run(recording, out, planar | settings)


def _run(recording: Path, out: Path, options: dict[str, Any]) -> None:
    from longreach.app.estimate import estimate
    from longreach.app.inputs import open_run
    from longreach.app.map_localization import opened_file
    from longreach.app.outputs import write_estimate
    from longreach.app.warmup import warm_up
    from longreach.io.whole_files import check_folder
    from longreach.view.export import add_to_report
    from longreach.view.replay import of_estimate

    check_folder(out)
    on_map = opened_file(options.pop("map"), options.pop("start"), options["fixes"])
    with shown_progress() as progress:
        run = open_run(recording, **options, progress=progress)
        warm_up(progress, "estimation", *(("mapping",) if on_map else ()))  # after what can be wrong with the files
        result = estimate(
            run.recording, run.robot, run.config, truth=run.truth, relations=run.relations, progress=progress, **on_map
        )
        write_estimate(result, out, progress)
        progress("scene for the report", 0.0)
        add_to_report(out, lambda: of_estimate(result))
    if result.verdict:
        typer.echo(result.verdict)
    print_metrics(result.metrics)
    for remark in result.evaluation.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"Everything is in {out}; open {out / 'report.html'}.")
