"""Trajectories as TUM files: a line `stamp x y z qx qy qz qw` a pose, in the order of motion."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from longreach.errors import RecordingError
from longreach.geometry import so3
from longreach.io.text_lines import numbers, text_lines
from longreach.io.whole_files import write_text
from longreach.trajectory import PoseTrajectory

HEADER = "# stamp[s] x[m] y[m] z[m] qx qy qz qw"
_NO_HEADING = "# positions only: the orientation is not known"


def write_tum(path: Path, trajectory: PoseTrajectory) -> None:
    """Write the poses of a base, stamps as recorded; nanometres and nanoseconds survive.

    A first line says so where headings are not known.
    """
    half = 0.5 * trajectory.poses[:, 2]
    columns = zip(
        trajectory.stamps.tolist(),
        trajectory.poses[:, 0].tolist(),
        trajectory.poses[:, 1].tolist(),
        np.sin(half).tolist(),
        np.cos(half).tolist(),
        strict=True,
    )
    lines = [HEADER] if trajectory.has_heading else [HEADER, _NO_HEADING]
    lines += [f"{t:.9f} {x:.9f} {y:.9f} 0 0 0 {s:.12f} {c:.12f}" for t, x, y, s, c in columns]
    write_text(path, "\n".join(lines) + "\n")


def write_spatial_tum(path: Path, stamps: Float[np.ndarray, " n"], T: Float[np.ndarray, "n 4 4"]) -> None:
    """Write poses in space (n, 4, 4), such as those of a tool."""
    rotation = so3.log(T[:, :3, :3])
    angle = np.linalg.norm(rotation, axis=1)
    q_xyz = 0.5 * np.sinc(angle / (2 * np.pi))[:, None] * rotation  # sin(angle/2) · axis
    rows = np.column_stack([T[:, :3, 3], q_xyz, np.cos(0.5 * angle)]).tolist()
    lines = [HEADER]
    lines += [f"{t:.9f} " + " ".join(f"{v:.12f}" for v in row) for t, row in zip(stamps.tolist(), rows, strict=True)]
    write_text(path, "\n".join(lines) + "\n")


def read_spatial_tum(path: Path) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 4 4"]]:
    """Read stamps (n,) [s] and poses in space (n, 4, 4).

    Raises:
        RecordingError: the file is empty, or a line is not 8 finite numbers with a quaternion that can be normalised.
    """
    table = pose_rows(path)
    T = np.zeros((len(table), 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = rotations(table[:, 4:]), table[:, 1:4], 1.0
    return table[:, 0], T


def pose_rows(path: Path, columns: int = 8) -> Float[np.ndarray, "n 8"]:
    """Read lines of a stamp, a position and a quaternion, and what else is in so many columns.

    A line that names the columns may come first.

    Raises:
        RecordingError: as `read_spatial_tum`.
    """
    rows = []
    for line, text in text_lines(path):
        words = text.replace(",", " ").split()
        if not rows and words[0].lower().startswith("timestamp"):
            continue
        row = numbers(path, line, words)
        if len(row) != columns or not np.all(np.isfinite(row[:8])):
            raise RecordingError(f"{path}, line {line}: a TUM line is stamp x y z qx qy qz qw, 8 finite numbers.")
        if not float(np.linalg.norm(row[4:8])) > 1e-6:
            raise RecordingError(f"{path}, line {line}: the quaternion is zero.")
        rows.append(row[:8])
    if not rows:
        raise RecordingError(f"{path} holds no poses.")
    return np.array(rows)


def rotations(q_xyzw: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 3 3"]:
    """Return the rotations of quaternions of any length but zero."""
    q = q_xyzw / np.linalg.norm(q_xyzw, axis=1, keepdims=True)
    q = np.where(q[:, 3:] < 0, -q, q)
    sine = np.linalg.norm(q[:, :3], axis=1, keepdims=True)
    scale = np.where(sine > 1e-12, 2 * np.arctan2(sine, q[:, 3:]) / np.maximum(sine, 1e-12), 2.0)
    return so3.exp(scale * q[:, :3])


def read_tum(path: Path) -> PoseTrajectory:
    """Read the planar part of a TUM file: x, y and the yaw; the order of the file is the order of motion."""
    stamps, T = read_spatial_tum(path)
    heading = np.arctan2(T[:, 1, 0], T[:, 0, 0])
    with path.open(encoding="utf-8", errors="replace") as lines:
        has_heading = all(line.strip() != _NO_HEADING for _, line in zip(range(3), lines, strict=False))
    return PoseTrajectory(stamps, np.column_stack([T[:, :2, 3], heading]), has_heading=has_heading)
