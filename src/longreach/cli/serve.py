"""longreach serve: the robot's side, for others to watch and command over a network."""

from pathlib import Path

import typer


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
    scans: bool = typer.Option(True, help="Whether a kinematic robot has its laser."),
    duration: float | None = typer.Option(None, help="End after so many seconds; else when it is interrupted."),
) -> None:
    """Serve a robot, simulated or real: its loop, its safety gate and what it says and hears on the network."""
    import logging
    import signal
    import sys
    import time

    from longreach.app.warmup import warm_up
    from longreach.cli.progress import shown_progress
    from longreach.io.robots import load_robot
    from longreach.live.server import Server, ServerConfig
    from longreach.live.serving import described, serve, simulated

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", stream=sys.stderr)
    reason: list[str] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: reason.append("The server was told to end."))
    loaded = load_robot(robot)
    config = ServerConfig(address, token, certificates)
    with shown_progress() as progress:
        warm_up(progress, "estimation", "kinematics", "control", "sim")
    sys.setswitchinterval(5e-4)  # the loop's thread does not wait long for the network's
    began = time.monotonic()

    def ended() -> str:
        if duration is not None and time.monotonic() - began > duration:
            reason.append("The time is over.")
        return reason[0] if reason else ""

    def ready(server: Server) -> None:
        typer.echo(f"Serving {loaded.name} at {address}; longreach connect {address} watches it. Ctrl-C ends it.")
        sys.stdout.flush()

    body = simulated(hardware, loaded, world, seed, scans)
    rhythm = serve(
        body, None, loaded, described(robot), config, ended,
        record=record, scans=scans or hardware == "sim", ready=ready,
    )  # fmt: skip
    typer.echo(
        f"{rhythm.ticks} ticks, {rhythm.late} late; a tick took {1e3 * rhythm.busy.percentile(50):.1f} ms, "
        f"{1e3 * rhythm.busy.percentile(99):.1f} ms at the 99th percentile."
    )
    if record is not None:
        typer.echo(f"The recording is {record}.")
