"""What longreach estimate does with a parameter file of robot_localization, and its options for that."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from longreach.cli.progress import shown_progress
from longreach.cli.tables import print_table

_WITH = "With robot_localization's parameters:"
NODE = typer.Option(None, help=f"{_WITH} the node, where the file has several.")
FILTER = typer.Option(None, help=f"{_WITH} ekf or ukf (default: as the node or the file is named).")
TRANSFORM = typer.Option([], help=f"{_WITH} where a frame is, PARENT:CHILD=x,y,z,roll,pitch,yaw; may be repeated.")
AS_ROBOT_LOCALIZATION = typer.Option(
    False, "--as-robot-localization", help=f"{_WITH} take over its known defects, to compare numbers."
)


def is_meant(config: Path | None, planar: Mapping[str, Any], spatial: Mapping[str, Any]) -> bool:
    """Whether the configuration is for robot_localization.

    Raises:
        ConfigError: options were given that do not go with it, or that do not go without it.
    """
    from longreach.errors import ConfigError
    from longreach.io.robot_localization import is_parameter_file

    if config is not None and is_parameter_file(config):
        given = [f"--{name}" for name, value in planar.items() if value is not None]
        if given:
            raise ConfigError(f"{config} is for robot_localization, beside which {', '.join(given)} cannot be given.")
        return True
    if any(spatial.values()):
        raise ConfigError(
            "--node, --filter, --transform and --as-robot-localization need parameters of robot_localization as "
            "--config."
        )
    if planar["robot"] is None:
        raise ConfigError("Give --robot, a description or a YAML file, or robot_localization's parameters as --config.")
    return False


def run(recording: Path, parameters: Path | None, out: Path, options: Mapping[str, Any]) -> None:
    """Estimate by the parameters, and write the results."""
    from longreach.app.spatial_estimate import estimate_from_parameters, write_spatial_run
    from longreach.evaluation.tables import metric_table
    from longreach.io.whole_files import check_folder

    assert parameters is not None
    check_folder(out)
    with shown_progress() as progress:
        found = estimate_from_parameters(recording, parameters, **options, progress=progress)
        write_spatial_run(found, out, progress)
    table = metric_table(found.main)
    print_table(table.header, table.rows)
    for remark in found.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"Everything is in {out}; open {out / 'report.html'}.")
