"""The 15-state filter one reading at a time, as they come in: late ones are taken where they belong, by going back.

The steps are those over a whole recording (`batch`). It differs from that only by when the rates are differenced for a
lever arm, and by predicting through a silence in one step.
"""

from bisect import bisect
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.estimation.spatial import _kernels as kernels
from longreach.estimation.spatial.rows import rows_of
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
    seen: Mapping[tuple[str, str], tuple[Reading, ...]]
    rates: tuple[float, np.ndarray, np.ndarray]  # since when, those then, and how they change


@dataclass(frozen=True, eq=False)
class SpatialState:
    """The filter with its recent past. late, ahead: how many readings were left out for their stamps."""

    settings: SpatialSettings
    frames: SpatialRecording
    model: tuple[Any, ...]
    control: tuple[Any, ...]
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
    s, P, still = settings, settings.initial_covariance.copy(), np.zeros(3)
    lead = 0.0 if s.as_robot_localization else 0.5  # as robot_localization does it, orientation lags a step behind
    model = (s.process_noise.copy(), lead, s.as_robot_localization, s.filter == "ukf", s.alpha, s.kappa)
    model += (s.dynamic_process_noise, s.two_d_mode)
    first = _Snapshot((-np.inf, "", ""), -np.inf, None, s.initial_state.copy(), P, P, {}, (-np.inf, still, still))
    return SpatialState(s, frames, model, _control(frames, s), (first,))


def _control(frames: SpatialRecording, s: SpatialSettings) -> tuple[Any, ...]:
    c = s.control
    if c is None:
        return np.zeros(0), np.zeros((0, 6)), np.zeros(6, dtype=np.bool_), np.zeros((4, 6)), 0.0
    commands = sorted(frames.commands, key=lambda command: command.stamp)
    limits = np.array([c.limits, c.gains, c.braking_limits, c.braking_gains])
    twists = np.array([command.twist for command in commands]).reshape(-1, 6)
    return np.array([command.stamp for command in commands]), twists, np.array(c.mask), limits, c.timeout


def step(state: SpatialState, reading: Reading) -> SpatialState:
    """Take one reading, up to `settings.history` seconds late; one further ahead waits to be confirmed by others."""
    lead, span = reading.stamp - state.stamp, state.settings.history
    started = len(state.history) > 1
    if started and -lead > span:
        return replace(state, late=state.late + 1)
    if started and lead > max(span, state.settings.sensor_timeout) and state.waiting < _PATIENCE:
        return replace(state, ahead=state.ahead + 1, waiting=state.waiting + 1)
    place = bisect(state.history, _key(reading), lo=1, key=lambda snapshot: snapshot.key)
    history = list(state.history[:place])
    for each in (reading, *(snapshot.reading for snapshot in state.history[place:])):
        assert each is not None
        history.append(_take(state, history[-1], each))
    first = bisect(history, history[-1].key[0] - span, lo=1, key=lambda snapshot: snapshot.key[0]) - 1
    return replace(state, history=tuple(history[min(first, len(history) - 2) :]), waiting=0)


def predict(state: SpatialState, stamp: float) -> tuple[Float[np.ndarray, "15"], Float[np.ndarray, "15 15"]]:
    """Return mean and covariance as they will be at a stamp not before the filter's [s]; the filter stays as it is."""
    x, P, taken = state.mean.copy(), state.covariance.copy(), state.history[-1].taken
    if -np.inf < taken < stamp:
        kernels.advance(x, P, stamp, stamp - taken, state.model, state.control, kernels.work_room())
    return x, P


def _key(reading: Reading) -> tuple[float, str, str]:
    return reading.stamp, reading.source, type(reading).__name__


def _take(state: SpatialState, before: _Snapshot, reading: Reading) -> _Snapshot:
    """Predict to a reading, and correct by it; a differential pose needs the one before it."""
    key = _key(reading)
    t, source = key[0], key[1:]
    earlier = before.seen.get(source, ())
    seen = {**before.seen, source: (*earlier[:1], reading)}
    rows = rows_of([*earlier, reading], state.frames, state.settings)
    if not rows or rows[0].stamps[-1] != t:
        return replace(before, key=key, reading=reading, seen=seen)
    x, P, room = before.mean.copy(), before.covariance.copy(), kernels.work_room()
    room[0][0][:] = before.bare
    r = rows[0]
    row = (r.block, r.k, r.gate, r.gravity, r.z[-1], r.H[-1], r.R[-1], r.lever[-1])
    since, rates, turning = before.rates
    if before.taken == -np.inf:
        since, rates = t, x[9:12].copy()
    kernels.step(x, P, before.taken, t, row, turning, state.model, state.control, room)
    if t - since >= 1.0 / state.settings.frequency:
        since, rates, turning = t, x[9:12].copy(), (x[9:12] - rates) / (t - since)
    return _Snapshot(key, t, reading, x, P, room[0][0], seen, (since, rates, turning))
