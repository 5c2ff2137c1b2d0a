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
    resume: bool = typer.Option(False, "--resume", help="After a cut of the network, go on with the rest of --plan."),
    method: str = typer.Option("task-priority", help="Of planning: task-priority or sqp."),
    velocity: str | None = typer.Option(None, help="Drive the base for --duration: v_x,v_y,ω in m/s and rad/s."),
    gripper: float | None = typer.Option(None, help="Close the fingers: 0 open to 1 closed."),
    stop: bool = typer.Option(False, "--stop", help="Stop the robot, whoever holds it."),
    reset: bool = typer.Option(False, "--reset", help="Let it move again after a stop."),
    duration: float | None = typer.Option(
        None, help="Watch, or drive, for so many seconds; else watch until interrupted, and drive for 1 s."
    ),
) -> None:
    """Watch a robot over the network, or let it do one thing."""
    import numpy as np

    from longreach.cli.options import check_duration, read_token
    from longreach.cli.watching import numbers, watched
    from longreach.errors import ConfigError, LiveError
    from longreach.io.reference import read_reference
    from longreach.live.client.client import connect
    from longreach.live.realtime_settings import apply_realtime_settings
    from longreach.planning.planner import check_method

    check_method(method)
    check_duration(duration)
    others = {"--move-to": move_to, "--tool-by": tool_by, "--plan": plan, "--gripper": gripper}
    others |= {"--stop": stop or None, "--reset": reset or None}
    given = [name for name, one in others.items() if one is not None]
    if duration is not None and velocity is None and given:
        raise ConfigError(f"--duration is for watching and for --velocity; leave it out with {' and '.join(given)}.")
    if resume and plan is None:
        raise ConfigError("--resume is for --plan; leave it out, or give one.")
    q = None if move_to is None else numbers(move_to, None, "--move-to")
    way = None if tool_by is None else numbers(tool_by, 3, "--tool-by")
    twist = None if velocity is None else numbers(velocity, 3, "--velocity")
    reference = None if plan is None else read_reference(plan)
    apply_realtime_settings()
    with connect(address, read_token(token_file), certificates=certificates) as client:
        if stop:
            client.stop()
        if reset:
            client.reset()
            if client.state.latched:
                raise LiveError(f"The robot is stopped again: {client.state.stop}")
        if gripper is not None:
            client.gripper(gripper)
        _move(client, method, q, way, reference, resume)
        if twist is not None:
            _drive(client, twist, 1.0 if duration is None else duration)
        if not (stop or reset) and all(given is None for given in (gripper, q, way, reference, twist)):
            watched(client, duration)
        typer.echo(f"The robot is at {np.array2string(client.state.q, precision=3, suppress_small=True)}.")


def _move(client: Any, method: str, q: Any, way: Any, reference: Any, resume: bool) -> None:
    """Move to a configuration, the tool by a way, along a reference: whatever is given."""
    if q is not None:
        client.move_to(q)
    if way is not None:
        T = client.robot.forward(client.state.q)
        T[:3, 3] += way
        client.move_to(T, method=method)
    if reference is not None:
        client.execute(client.plan(reference, method), resume=resume)


def _drive(client: Any, twist: Any, duration: float) -> None:
    """Drive the base by a twist for a time [s]."""
    import time

    until = time.monotonic() + duration
    while time.monotonic() < until:
        client.velocity(base=twist)
        time.sleep(0.02)
    client.velocity()
