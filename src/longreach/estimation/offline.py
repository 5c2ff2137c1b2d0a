"""The filter over a whole recording at once."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from longreach.errors import EstimationError
from longreach.estimation.fusion import Correction, Event, FusionState, step
from longreach.trajectory import PoseTrajectory


_Row = tuple[float, np.ndarray, np.ndarray]  # stamp, pose, covariance


class Run(NamedTuple):
    """The filter's last state, a row at every stamp in the frame odom, what became of each event; `localized`: in map.

    localized: None where nothing tells map from odom.
    """

    state: FusionState
    fused: PoseTrajectory
    corrections: list[Correction]
    localized: PoseTrajectory | None


def run(state: FusionState, events: Iterable[Event], progress: Callable[[int], None] | None = None) -> Run:
    """Take all events, sorted as `fusion.in_order` does, and keep the pose after the last one at each stamp.

    Give `init` a config with history=0: sorted events need none. progress: called now and then with the number of
    events taken. There is a row at every stamp that was taken, gated and refused measurements included (there the row
    is a prediction).
    """
    corrections: list[Correction] = []
    odom: list[_Row] = []
    in_map: list[_Row] = []
    pending = False  # the state's stamp has an event and no row yet

    def emit() -> None:
        last = state.history[-1]
        odom.append((last.key[0], *last.pose_in("odom")))
        in_map.append((last.key[0], *last.pose_in("map")) if state.has_map else odom[-1])

    for event in events:
        after, correction = step(state, event)
        if pending and after.stamp > state.stamp:
            emit()
        state = after
        pending = pending or event.stamp == state.stamp
        corrections.append(correction)
        if progress is not None and len(corrections) % 1000 == 0:
            progress(len(corrections))
    if pending:
        emit()
    if progress is not None:
        progress(len(corrections))
    if not odom:
        raise EstimationError("No measurement could be taken: none has a stamp at or after the start of the filter.")
    return Run(state, _path(odom), corrections, _path(in_map) if state.has_map else None)


def _path(rows: list[_Row]) -> PoseTrajectory:
    stamps, poses, covariances = zip(*rows, strict=True)
    return PoseTrajectory(np.array(stamps), np.array(poses), np.array(covariances))
