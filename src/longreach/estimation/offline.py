"""The filter over a whole recording at once."""

from collections.abc import Callable, Iterable

import numpy as np

from longreach.errors import EstimationError
from longreach.estimation.fusion import Correction, Event, FusionState, step
from longreach.trajectory import PoseTrajectory


def run(
    state: FusionState, events: Iterable[Event], progress: Callable[[int], None] | None = None
) -> tuple[FusionState, PoseTrajectory, list[Correction]]:
    """Take all events, sorted as `fusion.in_order` does, and keep the pose after the last one at each stamp.

    Give `init` a config with history=0: sorted events need none. progress: called now and then with the number of
    events taken. Returns the last state; a row at every stamp that was taken, gated and refused measurements included
    (there the row is a prediction); and what became of each event.
    """
    corrections: list[Correction] = []
    rows: list[tuple[float, np.ndarray, np.ndarray]] = []
    pending = False  # the state's stamp has an event and no row yet

    def emit() -> None:
        rows.append((state.stamp, *state.newest.pose))

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
    if not rows:
        raise EstimationError("No measurement could be taken: none has a stamp at or after the start of the filter.")
    stamps, poses, covariances = zip(*rows, strict=True)
    return state, PoseTrajectory(np.array(stamps), np.array(poses), np.array(covariances)), corrections
