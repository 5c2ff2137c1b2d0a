"""longreach info: what a recording holds."""

from pathlib import Path

import typer

from longreach.cli import input_options
from longreach.cli.tables import print_table


def command(
    recording: Path = typer.Argument(help="A .bag, .mcap, ROS 2 folder, CARMEN log or text folder."),
    topic: list[str] = input_options.TOPIC,
    clock: input_options.Clock = input_options.CLOCK,
) -> None:
    """List a recording's topics, sensors, rates, duration and gaps; with --topic, whether these can be read."""
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
    for remark in found.remarks:
        typer.echo(f"note: {remark}")
