"""The 15-state filter one reading at a time, as they come in: late ones are taken where they belong, by going back.

The same steps as `spatial.estimate_in_space` over a whole recording, from which it differs only by when the rates are
differenced for a lever arm, and by predicting through a silence in one step.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from longreach.estimation import _spatial_run_kernels as kernels
from longreach.estimation.spatial import control_of, model_of, rows_of
from longreach.spatial_measurement import Reading, SpatialRecording
from longreach.spatial_settings import SpatialSettings

_PATIENCE = 10  # readings ahead of the filter, with none nearer in between, before the next is believed


@dataclass(frozen=True, eq=False)
class _Snapshot:
    """The filter after a reading; `taken` is when it last corrected, `seen` the first and the last of each source."""

    key: tuple[float, str, str]
    taken: float
    reading: Reading | None
    mean: Float[np.ndarray, "15"]
    covariance: Float[np.ndarray, "15 15"]
    bare: Float[np.ndarray, "15 15"]
    seen: Mapping[str, tuple[Reading, Reading]]
    rates: tuple[float, np.ndarray, np.ndarray]  # since when, those then, and how they change


@dataclass(frozen=True, eq=False)
class SpatialState:
    """The filter with its recent past. late, ahead: how many readings were left out for their stamps."""

    settings: SpatialSettings
    frames: SpatialRecording
    history: tuple[_Snapshot, ...]
    late: int = 0
    ahead: int = 0
    waiting: int = 0

    @property
    def stamp(self) -> float:
        """Of the newest reading [s]; -inf before the first."""
        return self.history[-1].key[0]

    @property
    def mean(self) -> Float[np.ndarray, "15"]:
        """The state after the newest correction."""
        return self.history[-1].mean

    @property
    def covariance(self) -> Float[np.ndarray, "15 15"]:
        """Of the state."""
        return self.history[-1].covariance


def init(settings: SpatialSettings, frames: SpatialRecording) -> SpatialState:
    """Start a filter; `frames` says where frames are, and holds commands where there is a control input."""
    x, P, still = settings.initial_state.copy(), settings.initial_covariance.copy(), np.zeros(3)
    return SpatialState(
        settings, frames, (_Snapshot((-np.inf, "", ""), -np.inf, None, x, P, P.copy(), {}, (-np.inf, still, still)),)
    )


def step(state: SpatialState, reading: Reading) -> SpatialState:
    """Take one reading, up to `settings.history` seconds late; one further ahead waits to be confirmed by others."""
    lead, span = reading.stamp - state.stamp, state.settings.history
    started = len(state.history) > 1
    if started and -lead > span:
        return replace(state, late=state.late + 1)
    if started and lead > max(span, state.settings.sensor_timeout) and state.waiting < _PATIENCE:
        return replace(state, ahead=state.ahead + 1, waiting=state.waiting + 1)
    history, key = list(state.history), (reading.stamp, reading.source, type(reading).__name__)
    place = len(history)
    while place > 1 and history[place - 1].key > key:
        place -= 1
    later = [snapshot.reading for snapshot in history[place:]]
    del history[place:]
    for each in (reading, *later):
        assert each is not None
        history.append(_take(state, history[-1], each))
    oldest = history[-1].key[0] - span
    first = 0
    while first + 1 < len(history) - 1 and history[first + 1].key[0] <= oldest:
        first += 1
    return replace(state, history=tuple(history[first:]), waiting=0)


def predict(state: SpatialState, stamp: float) -> tuple[Float[np.ndarray, "15"], Float[np.ndarray, "15 15"]]:
    """Return mean and covariance as they will be at a stamp not before the filter's [s]; the filter stays as it is."""
    x, P, room = state.mean.copy(), state.covariance.copy(), kernels.work_room()
    taken = state.history[-1].taken
    if taken > -np.inf and stamp > taken:
        _advance(state, x, P, stamp, stamp - taken, room)
    return x, P


def _advance(state: SpatialState, x: np.ndarray, P: np.ndarray, t: float, dt: float, room: tuple) -> None:
    kernels.advance(x, P, t, dt, model_of(state.settings), control_of(state.frames, state.settings), room)


def _take(state: SpatialState, before: _Snapshot, reading: Reading) -> _Snapshot:
    """Predict to a reading, and correct by it; a differential pose needs the one before it."""
    source, t, x, P = f"{reading.source} {type(reading).__name__}", reading.stamp, before.mean, before.covariance
    key, seen = (t, reading.source, type(reading).__name__), before.seen.get(source)
    rows = rows_of([*(seen or ()), reading], state.frames, state.settings)
    known = {**before.seen, source: (seen[0] if seen else reading, reading)}
    if not rows or rows[0].stamps[-1] != t:
        return replace(before, key=key, reading=reading, seen=known)
    x, P, room, r = x.copy(), P.copy(), kernels.work_room(), rows[0]
    room[0][0][:] = before.bare
    since, rates, turning = before.rates
    is_first, gate = before.taken == -np.inf, r.gate
    if is_first:
        since, rates, gate = t, x[9:12].copy(), np.inf
    row = (r.block, r.k, r.z[-1].copy(), r.H[-1].copy(), r.R[-1].copy(), gate, r.lever[-1].copy(), r.gravity)
    if is_first:
        kernels.forget(P, row, room[0][0])
    elif t > before.taken:
        _advance(state, x, P, t, t - before.taken, room)
    kernels.take(x, P, row, turning, model_of(state.settings), room)
    if t - since >= 1.0 / state.settings.frequency:
        since, rates, turning = t, x[9:12].copy(), (x[9:12] - rates) / (t - since)
    return _Snapshot(key, t, reading, x, P, room[0][0].copy(), known, (since, rates, turning))
