"""Relative reference poses, as the SLAM benchmark of Kümmerle et al. 2009 gives them."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from longreach.errors import RecordingError
from longreach.io.text_lines import numbers, text_lines


def read_relations(
    path: Path,
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
    """Read lines `t1 t2 x y z roll pitch yaw`: the pose at t2 as seen from that at t1.

    Returns: stamps t1 (k,) and t2 (k,) [s] as recorded, and planar poses (k, 3) [m, m, rad].
    """
    rows = []
    for line, text in text_lines(path):
        row = numbers(path, line, text.split())
        if len(row) != 8 or not np.all(np.isfinite(row)):
            raise RecordingError(f"{path}, line {line}: a relation is t1 t2 x y z roll pitch yaw, 8 finite numbers.")
        rows.append(row)
    if not rows:
        raise RecordingError(f"{path} holds no relations.")
    table = np.array(rows)
    return table[:, 0], table[:, 1], table[:, [2, 3, 7]]
