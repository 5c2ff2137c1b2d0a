"""longreach serve: the robot's side, for others to watch and command over a network."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

_PATIENCE = 60.0  # with a ROS robot that is started at the same time [s]


def command(
    robot: str = typer.Option("thing", help="A robot's name, or a YAML file of your own."),
    hardware: str = typer.Option(
        "sim",
        help="sim (with physics: a URDF on mecanum wheels, as thing), kinematic (without forces: any robot), ros.",
    ),
    address: str = typer.Option("127.0.0.1:7447", help="Where to listen, host:port; other machines need certificates."),
    token_file: Path | None = typer.Option(
        None, help="File with the operators' secret, which you alone can read; else LONGREACH_TOKEN."
    ),
    watcher_token_file: Path | None = typer.Option(
        None, help="That of those who may look and stop only; else LONGREACH_WATCHER_TOKEN."
    ),
    certificates: Path | None = typer.Option(None, help="Folder with server.pem, server.key and ca.pem."),
    record: Path | None = typer.Option(None, help="Record everything into this .mcap."),
    world: str | None = typer.Option(
        None, help="Of a simulated robot: laboratory (default), office, corridor, warehouse, … or a YAML file."
    ),
    floor: str | None = typer.Option(None, help="Of sim: good, worn, wet, slippery, or a coefficient of friction."),
    seed: int | None = typer.Option(None, min=0, help="Seed of everything random in a simulation (default: 0)."),
    scans: bool = typer.Option(True, help="Whether a robot, kinematic or of ROS, has its laser."),
    obstacles: bool = typer.Option(True, help="Whether the base minds what its laser sees."),
    duration: float | None = typer.Option(None, help="End after so many seconds; else when it is interrupted."),
) -> None:
    """Serve a robot, simulated or real: its loop, its safety gate and what it says and hears on the network."""
    from longreach.app.operated import SIMULATED
    from longreach.app.warmup import warm_up
    from longreach.cli.options import WATCHER_TOKEN, check_duration, read_token
    from longreach.cli.progress import show_log, shown_progress
    from longreach.errors import RecordingError
    from longreach.io.bag_recorder import check_recording
    from longreach.io.robots import load_robot
    from longreach.io.whole_files import check_place
    from longreach.live.protocol.transport import server_settings
    from longreach.live.realtime_settings import apply_realtime_settings
    from longreach.live.server.rejected_connections import counted
    from longreach.live.server.server import ServerConfig
    from longreach.live.server.serving import described, rehearse, serve
    from longreach.rejection_counts import RejectionCounts

    loaded, rejections = load_robot(robot), RejectionCounts()
    token, watcher_token = read_token(token_file), read_token(watcher_token_file, WATCHER_TOKEN)
    server_settings(address, token, certificates, watcher_token)
    check_duration(duration)
    place = _world(hardware, loaded, world, floor, seed, scans)
    if record is not None:
        check_recording(record)
        check_place(record)
    show_log()  # what is wrong with the options has been said before anything that takes time
    with shown_progress() as progress:
        kind = hardware if hardware in SIMULATED else "kinematic"
        warm_up(progress, "estimation", "scans", "physics" if kind == "sim" else kind)
        progress("rehearsing", 0.0)
        rehearse(loaded, kind)
    body, wait_until, scans = _hardware(hardware, loaded, place, seed or 0, scans)
    apply_realtime_settings()

    with counted(rejections):
        rhythm, wrong = serve(
            body, wait_until, loaded, described(robot), ServerConfig(address, token, certificates, watcher_token),
            _ended(duration), record=record, scans=scans, obstacles=obstacles, rejections=rejections,
            ready=lambda _: _say_ready(loaded.name, address),
        )  # fmt: skip
    _say_how_it_was(rhythm, rejections)
    if wrong:
        raise RecordingError(wrong)
    if record is not None:
        typer.echo(f"The recording is {record}.")


def _world(kind: str, robot: Any, world: str | None, floor: str | None, seed: int | None, scans: bool) -> Any:
    """Return where a robot is simulated; None where it is not.

    Raises:
        ConfigError: it cannot be simulated, or an option would do nothing.
    """
    from longreach.app.operated import check_simulated
    from longreach.errors import ConfigError
    from longreach.sim.worlds import load_world

    if kind == "ros":
        if world is not None or floor is not None:
            raise ConfigError("A robot of ROS has a world and a floor of its own; leave out --world and --floor.")
        if seed is not None:
            raise ConfigError("Nothing of a robot of ROS is random here; leave out --seed.")
        return None
    if kind == "sim" and not scans:
        raise ConfigError(
            "A robot with physics has its laser always; take --hardware kinematic, or leave out --no-scans."
        )
    if floor is not None and kind == "kinematic":
        raise ConfigError("A kinematic robot slips alike on every floor; take --hardware sim, or leave out --floor.")
    place = load_world(world or "laboratory")
    place = place if floor is None else place.with_floor(floor)
    check_simulated(kind, robot, place)
    return place


def _say_ready(name: str, address: str) -> None:
    import sys

    typer.echo(f"Serving {name} at {address}; longreach connect {address} watches it. Ctrl-C ends it.")
    sys.stdout.flush()


def _say_how_it_was(rhythm: Any, rejections: Any) -> None:
    for what, durations in (("A tick took", rhythm.busy), ("It began late by", rhythm.lateness)):
        median, high = (1e3 * durations.percentile(p) for p in (50, 99))
        longest = 1e3 * durations.worst
        typer.echo(f"{what} {median:.1f} ms (median), {high:.1f} ms (99th percentile), {longest:.1f} ms at most.")
    typer.echo(f"{rhythm.late} of {rhythm.ticks} ticks were more than {1e3 * rhythm.tolerance:g} ms late.")
    for why, count in sorted(rejections.counts.items()):
        typer.echo(f"Refused {count}: {why}.")


def _hardware(kind: str, robot: Any, world: Any, seed: int, scans: bool) -> tuple[Any, Any, bool]:
    """Return the hardware, what waits in its time (None: the wall's), and whether it has scans."""
    if kind == "ros":
        from longreach.ros.hardware import connect_ros

        body = connect_ros(robot, scans=scans, timeout=_PATIENCE)
        return body, body.wait_until, scans and robot.description.lidar is not None
    from longreach.app.operated import simulated

    return simulated(kind, robot, world, seed, scans), None, scans


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
