"""longreach info: what a recording holds, and what the doctor finds wrong with it."""

from pathlib import Path
from typing import Any

import typer

from longreach.cli import input_options
from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_table


def command(
    recording: Path = typer.Argument(help="A .bag, .mcap, ROS 2 folder, CARMEN log or text folder."),
    robot: str | None = typer.Option(
        None, help="A shipped description or a YAML file: then clocks, frames, units and more are checked, too."
    ),
    topic: list[str] = input_options.TOPIC,
    clock: input_options.Clock = input_options.CLOCK,
    assume: list[str] = input_options.ASSUME,
) -> None:
    """List a recording's topics, sensors, rates, duration and gaps; with a robot check what can be checked."""
    from longreach.io.inspect import inspect_recording

    found = inspect_recording(
        recording, topics=input_options.named_values("--topic", topic, "lidar=/scan"), clock=clock.value
    )
    typer.echo(f"{recording}: {found.format}, {found.duration:.1f} s from {found.start:.6f}")
    header = ("topic", "type", "count", "rate Hz", "longest gap s", "backward stamps")
    rows = [
        (t.topic, t.type, str(t.count), f"{t.rate:.1f}", f"{t.longest_gap:.3f}", str(t.backward_stamps))
        for t in found.topics
    ]
    print_table(header, rows)
    remarks = list(found.remarks)
    if robot is not None:
        options = {
            "assume": input_options.named_values("--assume", assume, "lidar.mount.yaw=3.14"),
            "topics": input_options.named_values("--topic", topic, "lidar=/scan"),
            "clock": clock.value,
        }
        remarks += _findings(recording, robot, options)
    for remark in dict.fromkeys(remarks):
        typer.echo(f"note: {remark}")
    if robot is not None and not remarks:
        typer.echo("Nothing is wrong with it, as far as that can be seen before anything is fused.")


def _findings(path: Path, robot: str, options: dict[str, Any]) -> list[str]:
    from longreach.app.doctor import examine
    from longreach.app.estimate import sensor_mount
    from longreach.app.inputs import open_run

    with shown_progress() as progress:
        run = open_run(path, robot, **options, progress=progress)
    _, found = examine(run.recording, run.robot, sensor_mount(run.recording, run.robot, "imu"))
    return [*run.recording.remarks, *found]
