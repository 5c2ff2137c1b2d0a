"""Clean a reference of rows that cannot be true."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from longreach.trajectory import PoseTrajectory

_LONGEST_RUN = 10  # rows out of place at once; a motion capture that repeats each pose 3 to 4 times needs that many


def drop_glitches(truth: PoseTrajectory, speed_limit: float, noise: float = 0.02) -> tuple[PoseTrajectory, int]:
    """Return the trajectory without rows that the robot cannot have driven through, and how many were dropped.

    A step is a jump when it is longer than noise + speed_limit · duration. Dropped are runs of at most 10 rows with a
    jump out and a jump back to where the path goes on, and rows that hold the last pose until a jump ends it (the
    capture had lost the robot). A jump that stays is kept: which side of it is wrong cannot be told.

    Arguments: speed_limit [m/s] above all that the robot can do; noise [m] of a position, its stamp's included: shorter
    steps are never jumps, for the stamps of a recording may be microseconds apart.
    """
    kept = _rows(truth, _on_path(truth, speed_limit, noise))
    kept = _rows(kept, _fresh(kept, speed_limit, noise))
    return kept, len(truth) - len(kept)


def _rows(trajectory: PoseTrajectory, keep: Bool[np.ndarray, " n"]) -> PoseTrajectory:
    covariance = None if trajectory.covariance is None else trajectory.covariance[keep]
    return replace(
        trajectory,
        stamps=trajectory.stamps[keep],
        poses=trajectory.poses[keep],
        covariance=covariance,
        clock=trajectory.clock[keep],
    )


def _is_jump(truth: PoseTrajectory, i: int, j: int, speed_limit: float, noise: float) -> bool:
    distance = np.hypot(*(truth.poses[j, :2] - truth.poses[i, :2]))
    return bool(distance > noise + speed_limit * (truth.clock[j] - truth.clock[i]))


def _jumps(truth: PoseTrajectory, speed_limit: float, noise: float) -> list[int]:
    """Rows from which a jump leads to the next row."""
    distance = np.linalg.norm(np.diff(truth.poses[:, :2], axis=0), axis=1)
    return np.flatnonzero(distance > noise + speed_limit * np.diff(truth.clock)).tolist()


def _on_path(truth: PoseTrajectory, speed_limit: float, noise: float) -> Bool[np.ndarray, " n"]:
    keep = np.ones(len(truth), dtype=bool)
    jumps = _jumps(truth, speed_limit, noise)
    for n, out in enumerate(jumps):
        for back in jumps[n + 1 :]:
            if not keep[out] or back - out > _LONGEST_RUN:
                break
            if not _is_jump(truth, out, back + 1, speed_limit, noise):
                keep[out + 1 : back + 1] = False
                break
    return keep


def _fresh(truth: PoseTrajectory, speed_limit: float, noise: float) -> Bool[np.ndarray, " n"]:
    keep = np.ones(len(truth), dtype=bool)
    for row in _jumps(truth, speed_limit, noise):
        while row > 0 and np.array_equal(truth.poses[row], truth.poses[row - 1]):
            keep[row] = False
            row -= 1
    return keep
