"""The 15-state filter one reading at a time, as they come in: late ones are taken where they belong, by going back.

The steps are those over a whole recording (`batch`). It differs from that only by when the rates are differenced for a
lever arm, and by predicting through a silence in one step.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation import replay_buffer
from longreach.estimation.replay_buffer import Key, ReplayBuffer
from longreach.estimation.spatial import _kernels as kernels
from longreach.estimation.spatial.rows import rows_of
from longreach.spatial_measurement import Reading, SpatialRecording
from longreach.spatial_settings import SpatialSettings

_PATIENCE = 10  # readings ahead of the filter, with none nearer in between, before they are believed with the next


class _Snapshot(NamedTuple):
    """The filter after a reading; `taken` is when it last corrected, `seen` the first and the last of each source."""

    taken: float
    mean: np.ndarray
    covariance: np.ndarray
    bare: np.ndarray
    seen: Mapping[tuple[str, str], tuple[Reading, ...]]
    rates: tuple[float, np.ndarray, np.ndarray]  # since when, those then, and how they change


@dataclass(frozen=True, eq=False)
class SpatialState:
    """The filter with its recent past. late, ahead: how many readings were left out for their stamps."""

    settings: SpatialSettings
    frames: SpatialRecording
    model: tuple[Any, ...]
    control: tuple[Any, ...]
    buffer: ReplayBuffer
    late: int = 0
    ahead: int = 0

    @property
    def stamp(self) -> float:
        """Of the newest reading [s]; -inf before the first."""
        return self.buffer.newest.key[0]

    @property
    def mean(self) -> Float[np.ndarray, "15"]:
        """The state after the newest correction."""
        return self.buffer.newest.state.mean

    @property
    def covariance(self) -> Float[np.ndarray, "15 15"]:
        """Of the state."""
        return self.buffer.newest.state.covariance


def init(settings: SpatialSettings, frames: SpatialRecording) -> SpatialState:
    """Start a filter; `frames` says where frames are, and holds commands where there is a control input."""
    s, P, still = settings, settings.initial_covariance.copy(), np.zeros(3)
    lead = 0.0 if s.as_robot_localization else 0.5  # as robot_localization does it, orientation lags a step behind
    model = (s.process_noise.copy(), lead, s.as_robot_localization, s.filter == "ukf", s.alpha, s.kappa)
    model += (s.dynamic_process_noise, s.two_d_mode)
    first = _Snapshot(-np.inf, s.initial_state.copy(), P, P, {}, (-np.inf, still, still))
    return SpatialState(s, frames, model, _control(frames, s), replay_buffer.init((-np.inf, "", ""), first))


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
    span = state.settings.history
    limits = replay_buffer.Settings(span, max(span, state.settings.sensor_timeout), _PATIENCE)
    key = (reading.stamp, reading.source, type(reading).__name__)
    buffer, _, decided = replay_buffer.step(state.buffer, [(key, reading)], partial(_take, state), limits)
    late = [bool(one.key[0] < state.stamp) for one in decided if one.refused]
    return replace(state, buffer=buffer, late=state.late + sum(late), ahead=state.ahead + len(late) - sum(late))


def predict(state: SpatialState, stamp: float) -> tuple[Float[np.ndarray, "15"], Float[np.ndarray, "15 15"]]:
    """Return mean and covariance as they will be at a stamp not before the filter's [s]; the filter stays as it is."""
    x, P, taken = state.mean.copy(), state.covariance.copy(), state.buffer.newest.state.taken
    if -np.inf < taken < stamp:
        kernels.advance(x, P, stamp, stamp - taken, state.model, state.control, kernels.work_room())
    return x, P


def _take(state: SpatialState, before: _Snapshot, key: Key, reading: Reading) -> tuple[_Snapshot, None]:
    """Predict to a reading, and correct by it; a differential pose needs the one before it."""
    t, source = key[0], key[1:]
    earlier = before.seen.get(source, ())
    seen = {**before.seen, source: (*earlier[:1], reading)}
    rows = rows_of([*earlier, reading], state.frames, state.settings)
    if not rows or rows[0].stamps[-1] != t:
        return before._replace(seen=seen), None
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
    return _Snapshot(t, x, P, room[0][0], seen, (since, rates, turning)), None
