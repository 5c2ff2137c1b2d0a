"""longreach serve: the robot's side, for others to watch and command over a network."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

_PATIENCE = 60.0  # with a ROS robot that is started at the same time [s]


def command(
    robot: str = typer.Option("thing", help="A robot's name, or a YAML file of your own."),
    hardware: str = typer.Option("sim", help="sim (with physics), kinematic (without forces), or ros (a ROS 1 robot)."),
    address: str = typer.Option("127.0.0.1:7447", help="Where to listen, host:port; other machines need certificates."),
    token: str | None = typer.Option(None, envvar="LONGREACH_TOKEN", help="A secret that clients must know."),
    certificates: Path | None = typer.Option(None, help="Folder with server.pem, server.key and ca.pem."),
    record: Path | None = typer.Option(None, help="Write everything into a recording, .mcap or .bag."),
    world: str = typer.Option(
        "laboratory", help="Of a simulated robot: laboratory, office, corridor, … or a YAML file."
    ),
    seed: int = typer.Option(0, help="Seed of everything random in a simulation."),
    scans: bool = typer.Option(True, help="Whether a robot, kinematic or of ROS, has its laser."),
    duration: float | None = typer.Option(None, help="End after so many seconds; else when it is interrupted."),
) -> None:
    """Serve a robot, simulated or real: its loop, its safety gate and what it says and hears on the network."""
    import logging
    import sys

    from longreach.app.operated import SIMULATED
    from longreach.app.warmup import warm_up
    from longreach.cli.progress import shown_progress
    from longreach.io.robots import load_robot
    from longreach.live.realtime_settings import apply_realtime_settings
    from longreach.live.server.rejected_connections import counted
    from longreach.live.server.server import ServerConfig
    from longreach.live.server.serving import described, rehearse, serve
    from longreach.rejection_counts import RejectionCounts

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", stream=sys.stderr)
    loaded, config, rejections = load_robot(robot), ServerConfig(address, token, certificates), RejectionCounts()
    with shown_progress() as progress:
        kind = hardware if hardware in SIMULATED else "kinematic"
        warm_up(progress, "estimation", "scans", "physics" if kind == "sim" else kind)
        progress("rehearsing", 0.0)
        rehearse(loaded, kind)
    body, wait_until, scans = _hardware(hardware, loaded, world, seed, scans)
    apply_realtime_settings()

    with counted(rejections):
        rhythm = serve(
            body, wait_until, loaded, described(robot), config, _ended(duration),
            record=record, scans=scans, rejections=rejections, ready=lambda _: _say_ready(loaded.name, address),
        )  # fmt: skip
    _say_how_it_was(rhythm, rejections)
    if record is not None:
        typer.echo(f"The recording is {record}.")


def _say_ready(name: str, address: str) -> None:
    import sys

    typer.echo(f"Serving {name} at {address}; longreach connect {address} watches it. Ctrl-C ends it.")
    sys.stdout.flush()


def _say_how_it_was(rhythm: Any, rejections: Any) -> None:
    median, longest = (1e3 * rhythm.busy.percentile(p) for p in (50, 99))
    typer.echo(f"{rhythm.ticks} ticks; one took {median:.1f} ms, {longest:.1f} ms at the 99th percentile.")
    for why, count in sorted(rejections.counts.items()):
        typer.echo(f"Refused {count}: {why}.")


def _hardware(kind: str, robot: Any, world: str, seed: int, scans: bool) -> tuple[Any, Any, bool]:
    """Return the hardware, what waits in its time (None: the wall's), and whether it has scans."""
    if kind == "ros":
        from longreach.ros.hardware import connect_ros

        body = connect_ros(robot, scans=scans, timeout=_PATIENCE)
        return body, body.wait_until, scans and robot.description.lidar is not None
    from longreach.app.operated import simulated

    return simulated(kind, robot, world, seed, scans), None, scans or kind == "sim"


def _ended(duration: float | None) -> Callable[[], str]:
    """Return what says why it shall end: the time is over, or the process was signalled."""
    import signal
    import time

    began, signalled = time.monotonic(), []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: signalled.append("The server was asked to end."))

    def ended() -> str:
        if signalled:
            return signalled[0]
        return "The time is over." if duration is not None and time.monotonic() - began > duration else ""

    return ended
