"""longreach connect: the client's side: watch a robot that is served somewhere, and command it."""

from pathlib import Path
from typing import Any

import typer


def command(
    address: str = typer.Argument("127.0.0.1:7447", help="Where the robot is served, host:port."),
    token_file: Path | None = typer.Option(
        None, help="File with the server's secret, which you alone can read; else LONGREACH_TOKEN."
    ),
    certificates: Path | None = typer.Option(
        None, help="Folder with ca.pem, and client.pem and client.key if need be."
    ),
    move_to: str | None = typer.Option(None, help="Joint angles of the arm, or of all joints, as numbers with commas."),
    tool_by: str | None = typer.Option(None, help="Move the tool by x,y,z in metres, in map's axes."),
    plan: Path | None = typer.Option(None, help="Follow a reference: TUM poses of the tool, or CSV."),
    method: str = typer.Option("task-priority", help="Of planning: task-priority or sqp."),
    velocity: str | None = typer.Option(None, help="Drive the base for --duration: v_x,v_y,ω in m/s and rad/s."),
    gripper: float | None = typer.Option(None, help="Close the fingers: 0 open to 1 closed."),
    stop: bool = typer.Option(False, "--stop", help="Stop the robot, whoever holds it."),
    reset: bool = typer.Option(False, "--reset", help="Let it move again after a stop."),
    duration: float | None = typer.Option(None, help="Watch, or drive, for so many seconds; else until interrupted."),
) -> None:
    """Watch a robot over the network, or let it do one thing."""
    import numpy as np

    from longreach.cli.tokens import read_token
    from longreach.cli.watching import watched
    from longreach.live.client.client import connect
    from longreach.live.realtime_settings import apply_realtime_settings
    from longreach.planning.planner import check_method

    check_method(method)
    apply_realtime_settings()
    with connect(address, read_token(token_file), certificates=certificates) as client:
        if stop:
            client.stop()
        if reset:
            client.reset()
        if gripper is not None:
            client.gripper(gripper)
        _move(client, method, move_to, tool_by, plan)
        if velocity is not None:
            _drive(client, velocity, duration or 1.0)
        if not any((stop, reset, gripper is not None, move_to, tool_by, plan, velocity)):
            watched(client, duration)
        typer.echo(f"The robot is at {np.array2string(client.state.q, precision=3, suppress_small=True)}.")


def _move(client: Any, method: str, move_to: str | None, tool_by: str | None, plan: Path | None) -> None:
    """Move to a configuration, the tool by a way, along a reference: whatever is given."""
    from longreach.cli.watching import numbers

    robot = client.robot
    if move_to is not None:
        client.move_to(numbers(move_to, (robot.dof, robot.dof - robot.base.stop), "--move-to"))
    if tool_by is not None:
        T = robot.forward(client.state.q)
        T[:3, 3] += numbers(tool_by, (3,), "--tool-by")
        client.move_to(T, method=method)
    if plan is not None:
        from longreach.io.reference import read_reference

        client.execute(client.plan(read_reference(plan), method))


def _drive(client: Any, velocity: str, duration: float) -> None:
    """Drive the base for a time [s]."""
    import time

    from longreach.cli.watching import numbers

    twist, until = numbers(velocity, (3,), "--velocity"), time.monotonic() + duration
    while time.monotonic() < until:
        client.velocity(base=twist)
        time.sleep(0.02)
    client.velocity()
