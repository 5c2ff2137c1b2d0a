"""References from files: a tool's poses as TUM lines, or a CSV table whose first line names its columns."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from longreach.errors import PlanningError, RecordingError
from longreach.geometry import so3
from longreach.io.text_lines import numbers, text_lines
from longreach.io.tum import read_spatial_tum
from longreach.reference import Reference

_TOOL = ("x", "y", "z", "qx", "qy", "qz", "qw")  # T_world_tool [m], quaternion
_BASE = ("base_x", "base_y", "base_theta")  # [m, m, rad]
_STAMP = "stamp"  # [s]


def read_reference(path: Path) -> Reference:
    """Read what a robot shall follow.

    A .csv file has a column `stamp` and those of the tool (x y z qx qy qz qw), of the base (base_x base_y base_theta)
    or both, in any order. Any other file holds TUM lines of the tool's poses.

    Raises:
        RecordingError: the file is not there, or a line of it cannot be read; the sentence names the line.
        PlanningError: what it holds is no reference, such as stamps that do not increase.
    """
    try:
        if ".csv" in path.suffixes:
            return _read_table(path)
        stamps, T = read_spatial_tum(path)
        return Reference(stamps, tool=T)
    except PlanningError as error:
        raise PlanningError(f"{path}: {error}") from error


def _read_table(path: Path) -> Reference:
    names: list[str] = []
    rows: list[list[float]] = []
    for line, text in text_lines(path):
        words = [word.strip() for word in text.split(",")]
        if not names:
            names = words
            _check_header(path, names)
            continue
        rows.append(numbers(path, line, words))
        if len(words) != len(names) or not np.all(np.isfinite(rows[-1])):
            raise RecordingError(f"{path}, line {line}: expected {len(names)} finite numbers.")
    if not rows:
        raise RecordingError(f"{path} holds no poses.")
    column = dict(zip(names, np.array(rows).T, strict=True))
    tool = base = None
    if "x" in column:
        tool = _poses(path, np.column_stack([column[name] for name in _TOOL]))
    if "base_x" in column:
        base = np.column_stack([column[name] for name in _BASE])
    return Reference(column[_STAMP], tool=tool, base=base)


def _check_header(path: Path, names: list[str]) -> None:
    tool, base = set(names) & set(_TOOL), set(names) & set(_BASE)
    complete = len(tool) in (0, len(_TOOL)) and len(base) in (0, len(_BASE)) and len(tool) + len(base) > 0
    if not complete or len(names) != len(set(names)) or set(names) - tool - base != {_STAMP}:
        raise RecordingError(
            f"{path}: its first line must name the columns {_STAMP} and {' '.join(_TOOL)}, or {' '.join(_BASE)}, or "
            f"both, separated by commas; it names {' '.join(names)}."
        )


def _poses(path: Path, rows: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 4 4"]:
    T = np.zeros((len(rows), 4, 4))
    T[:, :3, 3], T[:, 3, 3] = rows[:, :3], 1.0
    for i, q_xyzw in enumerate(rows[:, 3:]):
        norm = float(np.linalg.norm(q_xyzw))
        if not norm > 1e-6:
            raise RecordingError(f"{path}: the quaternion of pose {i} is zero.")
        V = so3.hat(q_xyzw[:3] / norm)
        T[i, :3, :3] = np.eye(3) + 2.0 * q_xyzw[3] / norm * V + 2.0 * V @ V
    return T
