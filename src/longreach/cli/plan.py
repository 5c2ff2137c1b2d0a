"""longreach plan: a trajectory of base and arm together that follows a reference."""

from pathlib import Path

import typer

from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_table


def command(
    reference: str = typer.Argument(help="A file (TUM poses of the tool, or CSV), or dual-trajectory."),
    robot: str = typer.Option(..., help="A shipped robot (thing, ur10, panda_cart, …), a YAML file or a URDF."),
    out: Path = typer.Option(..., help="Folder for the results; made if it is not there."),
    method: str = typer.Option("task-priority", help="The planner: task-priority or sqp."),
    tool: str | None = typer.Option(None, help="The frame to move (default: the robot's own)."),
    iterations: int | None = typer.Option(None, help="At most so many for a waypoint; by sqp, in all."),
    problem: Path | None = typer.Option(None, help="By sqp: YAML of costs, constraints and links (default: (4.34))."),
    coupled: bool = typer.Option(True, "--coupled/--alone", help="By sqp: all waypoints at once, or each by itself."),
    length: float = typer.Option(2.0, help="Length of the dual trajectory's line, in metres."),
    amplitude: float = typer.Option(0.2, help="Amplitude of its base's sinusoid, in metres."),
    waypoints: int = typer.Option(200, help="Waypoints of the dual trajectory."),
    duration: float = typer.Option(20.0, help="Duration of the dual trajectory, in seconds."),
    retime: bool = typer.Option(False, help="Go as fast as the joints' limits of speed and acceleration allow."),
) -> None:
    """Plan base and arm as one chain along a reference and write the trajectory, figures and a report."""
    from longreach.app.plan import DUAL, PlanConfig, make_plan, write_plan
    from longreach.app.warmup import warm_up
    from longreach.evaluation.tables import metric_table
    from longreach.io.config import read_yaml, validated
    from longreach.io.reference import read_reference
    from longreach.io.robots import load_robot
    from longreach.io.whole_files import check_folder
    from longreach.planning.planner import check_method
    from longreach.planning.problem_config import problem_of

    settings = {
        "method": method,
        "iterations": iterations,
        "coupled": coupled,
        "length": length,
        "amplitude": amplitude,
        "waypoints": waypoints,
        "duration": duration,
        "retime": retime,
    }
    check_method(method)
    check_folder(out)
    config = validated(PlanConfig, settings, "the options")
    posed = None if problem is None else problem_of(read_yaml(problem) or {})
    model = load_robot(robot)
    model = model if tool is None else model.with_tool(tool)
    followed = None if reference == DUAL else read_reference(Path(reference))
    with shown_progress() as progress:
        warm_up(progress, "task priority", *(["sqp"] if method == "sqp" else []))
        planned = make_plan(model, followed, config, progress, posed)
        write_plan(planned, out, progress)
    table = metric_table(planned.metrics)
    print_table(table.header, table.rows)
    for remark in planned.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"Everything is in {out}; open {out / 'report.html'}.")
