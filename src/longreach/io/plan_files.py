"""A planned trajectory as files: a CSV table, and a trajectory_msgs/JointTrajectory in an MCAP."""

from pathlib import Path

import numpy as np

from longreach.configuration import ConfigurationTrajectory
from longreach.io.bag_writer import new_bag
from longreach.io.messages import joint_trajectory
from longreach.io.whole_files import write_text

TOPIC = "/joint_trajectory"


def write_trajectory_csv(path: Path, trajectory: ConfigurationTrajectory) -> None:
    """Write a header and a row a configuration: stamp [s], positions, then velocities, SI units."""
    names = trajectory.joint_names or tuple(f"q{i}" for i in range(trajectory.q.shape[1]))
    lines = [",".join(["stamp", *names, *(f"{name}_velocity" for name in names)])]
    table = np.column_stack([trajectory.stamps, trajectory.q, trajectory.velocities])
    lines += [",".join(f"{value:.12g}" for value in row) for row in table.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def write_trajectory_mcap(path: Path, trajectory: ConfigurationTrajectory) -> None:
    """Write one trajectory_msgs/JointTrajectory; times count from the trajectory's first row, whose stamp it bears."""
    start = float(trajectory.stamps[0])
    with new_bag(path) as bag:
        bag.write(TOPIC, joint_trajectory(bag.types, start, trajectory), start)
