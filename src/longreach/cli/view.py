"""longreach view: a run, or a robot over the network, in the browser."""

from pathlib import Path

import typer


def command(
    recording: Path | None = typer.Argument(None, help="A folder of run or estimate, or a recording."),
    robot: str | None = typer.Option(None, help="A shipped description or a YAML file (default: the run's own)."),
    estimate: Path | None = typer.Option(None, help="The folder that longreach estimate has written about it."),
    port: int = typer.Option(8080, min=0, max=65535, help="Where the page is served, on this machine alone."),
    export: Path | None = typer.Option(None, help="Write the scene as one HTML file, and serve nothing."),
    connect: str | None = typer.Option(None, help="Watch and command the robot that is served at host:port."),
    token_file: Path | None = typer.Option(
        None, help="File with the server's secret, which you alone can read; else LONGREACH_TOKEN."
    ),
    certificates: Path | None = typer.Option(None, help="Folder with ca.pem, and client.pem and client.key."),
    open: bool = typer.Option(False, "--open", help="Open the page in this machine's browser."),
    duration: float | None = typer.Option(None, help="End after so many seconds; else when interrupted."),
) -> None:
    """Show a recorded run, or a robot over the network, in the browser."""
    from longreach.cli.options import check_duration, read_token
    from longreach.errors import ConfigError
    from longreach.io.whole_files import check_place

    check_duration(duration)
    if (recording is None) == (connect is None):
        raise ConfigError("Give either a recording to look at, or --connect with a robot's address.")
    if connect is not None and not (export is None and robot is None and estimate is None):
        raise ConfigError("--export, --robot and --estimate are for a recording; leave them out with --connect.")
    if recording is not None and not (token_file is None and certificates is None):
        raise ConfigError(
            "--token-file and --certificates are for a robot's network; give --connect, or leave them out."
        )
    if export is None:
        _check_port(port)
    else:
        check_place(export)
        if export.is_dir():
            raise ConfigError(f"{export} is a folder; give a file for the scene, as {export / 'run.html'}.")
    if recording is not None:
        _show_recording(recording, robot, estimate, port, export, open, duration)
    elif connect is not None:
        _show_robot(connect, read_token(token_file), certificates, port, open, duration)


def _check_port(port: int) -> None:
    """Raise a ConfigError where no page can be served at a port; viser would take the next one that is free."""
    import socket

    from longreach.errors import ConfigError

    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise ConfigError(f"No page can be served at port {port}: {error.strerror}; choose a --port.") from error


def _show_recording(
    recording: Path,
    robot: str | None,
    estimate: Path | None,
    port: int,
    export: Path | None,
    browser: bool,
    duration: float | None,
) -> None:
    from longreach.io.robots import load_robot
    from longreach.view.page import open_page
    from longreach.view.player import Player
    from longreach.view.replay import read_run

    if robot is not None:
        load_robot(robot)  # what is wrong with it is said before anything is read
    typer.echo(f"Reading {recording} …")
    run = read_run(recording, robot, estimate)
    if export is not None:
        from longreach.io.whole_files import write_text
        from longreach.view.export import page_html

        write_text(export, page_html(run))
        typer.echo(f"The scene is in {export}; open it in a browser.")
        return
    server = open_page(port=port)
    player = Player(server, run)
    player.play()
    _serve(server, player.loop, browser, duration)


def _serve(server: object, loop: object, browser: bool, duration: float | None) -> None:
    """Say where the page is, and let it run until the time is over or somebody interrupts."""
    import tempfile
    import threading
    from typing import Any, cast

    from longreach.view.page import close_page

    page, work = cast(Any, server), cast(Any, loop)
    until = threading.Event()
    if duration is not None:
        timer = threading.Timer(duration, until.set)
        timer.daemon = True
        timer.start()
    address = page.gate.address  # with its secret
    with tempfile.TemporaryDirectory(prefix="longreach-") as folder:  # nobody else may look into it
        opened = browser and _opened(address, Path(folder) / "page.html")
        say = f"The page is {address}" if opened else f"Open {address} in a browser"
        typer.echo(f"{say}; Ctrl+C ends it.")
        try:
            work(until)
        finally:
            close_page(page)


def _opened(address: str, file: Path) -> bool:
    """Open a page by a file that leads to it: the list of processes shows what a browser is started with."""
    import webbrowser

    file.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
    return webbrowser.open(file.as_uri())


def _show_robot(
    address: str, token: str | None, certificates: Path | None, port: int, browser: bool, duration: float | None
) -> None:
    from functools import partial

    from longreach.app.warmup import warm_up
    from longreach.cli.progress import shown_progress
    from longreach.live.client.client import connect
    from longreach.live.protocol.transport import split_address
    from longreach.live.realtime_settings import apply_realtime_settings
    from longreach.view.page import open_page
    from longreach.view.teleop import Teleop

    split_address(address)
    with shown_progress() as progress:
        warm_up(progress, "kinematics")
    apply_realtime_settings()
    with connect(address, token, certificates=certificates, name="page") as client:
        server = open_page(port=port)
        ready = partial(warm_up, None, "task priority")  # the robot is seen and driven meanwhile
        _serve(server, Teleop(server, client, prepare=ready).loop, browser, duration)
