"""longreach ros: nodes for ROS 1, which are started by hand or by roslaunch."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from longreach.cli.progress import show_log, shown_progress

app = typer.Typer(no_args_is_help=True, help="Nodes for ROS 1: the estimate alone, or a simulated robot.")
# roslaunch gives a node's name and remappings as NAME:=VALUE, which rospy reads by itself.
_LAUNCHED = {"allow_extra_args": True}
_ROBOT = typer.Option("thing", help="A shipped description (thing, husky, …) or a YAML file, with its topics.")
_TOPIC = typer.Option([], help="ROLE=TOPIC in place of the description's: wheels, lidar, imu, fixes, joints, wrench.")


@app.command(context_settings=_LAUNCHED)
def estimate(
    context: typer.Context,
    robot: str = _ROBOT,
    config: Path | None = typer.Option(
        None, help="YAML file with the node's settings; under `estimate` the estimate's."
    ),
    topic: list[str] = _TOPIC,
    sources: str | None = typer.Option(
        None, help="What to fuse, of wheels,lidar,imu,fixes (default: whatever speaks)."
    ),
    frame: str | None = typer.Option(None, help="The frame of the smooth estimate (default: odom)."),
    tf: bool | None = typer.Option(None, "--tf/--no-tf", help="Whether tf is sent, too."),
) -> None:
    """Estimate from topics: /odometry/filtered, /odometry/settled, tf and /diagnostics."""
    from longreach.app.warmup import warm_up
    from longreach.io.config import load_description, read_yaml, validated
    from longreach.ros.estimate import NodeConfig, run
    from longreach.ros.sensors import with_topics

    _check(context)
    description = with_topics(load_description(robot), topic)
    settings = (read_yaml(config) if config is not None else None) or {}
    given: dict[str, Any] = {name: value for name, value in (("frame", frame), ("tf", tf)) if value is not None}
    if sources is not None:
        names = [name.strip() for name in sources.split(",") if name.strip()]
        given["estimate"] = {**settings.get("estimate", {}), "sources": names}
    chosen = validated(NodeConfig, {**settings, **given}, str(config or "the options"))
    show_log()
    with shown_progress() as progress:
        warm_up(progress, "estimation")
    run(description, chosen)


@app.command(context_settings=_LAUNCHED)
def robot(
    context: typer.Context,
    robot: str = _ROBOT,
    topic: list[str] = _TOPIC,
    world: str = typer.Option("laboratory", help="laboratory, office, corridor, warehouse, hall, or a YAML file."),
    seed: int = typer.Option(0, help="Seed of everything random."),
    physics: bool = typer.Option(True, "--physics/--no-physics", help="With forces, or without for less work."),
    config: Path | None = typer.Option(None, help="YAML file with the node's settings: topics, controller, safety."),
) -> None:
    """Simulate a robot behind the topics of the thesis': sensors out, /cmd_vel and a trajectory action in."""
    from longreach.app.operated import simulated
    from longreach.app.warmup import warm_up
    from longreach.io.config import read_config
    from longreach.io.robots import load_robot
    from longreach.ros.robot import RobotConfig, run
    from longreach.ros.sensors import with_topics

    _check(context)
    loaded = load_robot(robot)
    loaded = replace(loaded, description=with_topics(loaded.description, topic))
    settings = read_config(config, RobotConfig) if config is not None else RobotConfig()
    show_log()
    with shown_progress() as progress:
        warm_up(progress, "control", "physics" if physics else "kinematic")
    run(loaded, simulated("sim" if physics else "kinematic", loaded, world, seed), settings)


@app.command()
def package(folder: Path = typer.Argument(help="A folder of ROS packages, such as a workspace's src.")) -> None:
    """Write a ROS package with our launch files, so that roslaunch finds them."""
    from longreach.ros.package import write_package

    written = write_package(folder)
    typer.echo(f"The package is {written}; export ROS_PACKAGE_PATH={folder.resolve()}:$ROS_PACKAGE_PATH, then")
    typer.echo("roslaunch longreach simulated.launch, estimate.launch or system.launch.")


def _check(context: typer.Context) -> None:
    """Refuse what roslaunch did not give."""
    strange = [argument for argument in context.args if ":=" not in argument]
    if strange:
        raise typer.BadParameter(
            f"{' '.join(strange)} is not known here; see longreach ros {context.info_name} --help."
        )
