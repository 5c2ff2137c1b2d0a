"""The filter over any number of sources: measurements in the order of their stamps, late ones put where they belong.

State is a chain of snapshots, one after every event of the last `history` seconds. A late event goes back to the
newest snapshot before it and everything after is taken again, so that the result is that of sorted input.
What one event does: `update.take`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from heapq import merge
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import EstimationError
from longreach.estimation.ekf import CLONES, REFERENCE, SCALE
from longreach.estimation.filter_config import FilterConfig
from longreach.estimation.gaussian import Belief
from longreach.estimation.snapshot import Clone, Correction, Event, Keyframe, PoseClone, Snapshot, Tally
from longreach.estimation.update import predicted, take
from longreach.measurement import RelativePoseMeasurement

__all__ = [
    "Clone",
    "Correction",
    "Event",
    "FusionState",
    "Keyframe",
    "PoseClone",
    "Snapshot",
    "Tally",
    "in_order",
    "init",
    "step",
    "steps",
]


class _Ahead(NamedTuple):
    """A run of stamps too far ahead to be believed."""

    first: float
    newest: float
    length: int


@dataclass(frozen=True, slots=True, eq=False)
class FusionState:
    """The filter's state: `history` ends with the present; `turned_away` counts by source what no history takes."""

    config: FilterConfig
    history: tuple[Snapshot, ...]
    turned_away: Mapping[str, int] = field(default_factory=dict)
    ahead: _Ahead | None = None

    @property
    def stamp(self) -> float:
        """Time of the newest event taken [s]."""
        return self.history[-1].key[0]

    @property
    def clones(self) -> Mapping[str, Clone]:
        """The pose clone that relative poses of each source refer to."""
        return self.history[-1].clones

    @property
    def belief(self) -> Belief:
        """The belief at `stamp`."""
        return self.history[-1].belief

    def belief_at(self, stamp: float) -> Belief:
        """Return what is believed at a time [s], predicted where it is after the newest event."""
        newest = self.history[-1]._replace(links=None)
        return (predicted(self.config, newest, (stamp, 0, "")) if stamp > self.stamp else newest).belief

    @property
    def counters(self) -> dict[str, Tally]:
        """What became of the measurements, by source."""
        tallies = dict(self.history[-1].tallies)
        for source, count in self.turned_away.items():
            tally = tallies.get(source, Tally())
            tallies[source] = tally._replace(refused=tally.refused + count)
        return tallies


_Key = tuple[float, int, str]


def _key(event: Event) -> _Key:
    """Order of events at one stamp: a step of wheel odometry first, with which the others are compared.

    A pose clone comes last, so that what refers to the former one still finds it.
    """
    steps = isinstance(event, RelativePoseMeasurement) and event.reading_covariance is not None
    return event.stamp, 2 if isinstance(event, PoseClone) else 0 if steps else 1, event.source


def in_order(events: Iterable[Event]) -> list[Event]:
    """Sort events as the filter takes them."""
    return sorted(events, key=_key)


def init(
    stamp: float,
    pose: Float[np.ndarray, "3"],
    pose_covariance: Float[np.ndarray, "3 3"] | None = None,
    config: FilterConfig | None = None,
) -> FusionState:
    """Start at a pose [m, m, rad] in the world, which is the first reference, at rest as far as is known.

    pose_covariance of ξ = log(mean⁻¹ · truth); None: the pose is exact, as where a run defines its own frame.
    """
    config = config or FilterConfig()
    mean, P = np.zeros(CLONES), np.zeros((CLONES, CLONES))
    mean[REFERENCE:] = pose
    if pose_covariance is not None:
        P[REFERENCE:, REFERENCE:] = pose_covariance
    P[3:6, 3:6] = np.diag(np.square(config.initial_twist_deviation))
    P[6:9, 6:9] = np.diag(config.motion.acceleration_variance)
    P[9, 9] = config.initial_gyro_bias_deviation**2
    P[SCALE : SCALE + 3, SCALE : SCALE + 3] = np.diag(config.wheels.scale_variance)
    if not (
        np.isfinite(stamp)
        and np.all(np.isfinite(mean))
        and np.all(np.isfinite(P))
        and np.linalg.eigvalsh(P[REFERENCE:, REFERENCE:])[0] >= -1e-12
    ):
        raise EstimationError(
            "The filter must start at a finite stamp and pose, with a positive semidefinite covariance."
        )
    mean.flags.writeable = P.flags.writeable = False
    return FusionState(config, (Snapshot((float(stamp), -1, ""), None, mean, P),))


def step(state: FusionState, event: Event) -> tuple[FusionState, Correction]:
    """Take one measurement or pose clone, in the order of stamps or up to `history` seconds late."""
    state, corrections = steps(state, [event])
    return state, corrections[0]


def steps(state: FusionState, events: Iterable[Event]) -> tuple[FusionState, list[Correction]]:
    """Take several at once, with the result of `step` one after the other in order; what comes after is retaken once.

    The corrections are in the events' order, `in_order`.
    """
    ordered = in_order(events)
    if not ordered:
        return state, []
    config, turned_away, ahead, newest = state.config, state.turned_away, state.ahead, state.stamp
    corrections: list[Correction] = []
    taken: list[tuple[_Key, Event, int]] = []  # and the place of its correction
    for event in ordered:
        reason, ahead = _too_late_or_early(config, newest, state.history[0].key[0], ahead, event.stamp)
        corrections.append(Correction(event.stamp, event.source, "refused", reason))
        if reason:
            turned_away = {**turned_away, event.source: turned_away.get(event.source, 0) + 1}
        else:
            taken.append((_key(event), event, len(corrections) - 1))
            newest = max(newest, event.stamp)
    history = list(state.history)
    if taken:
        later: list[tuple[_Key, Event | None, int]] = []
        while len(history) > 1 and history[-1].key > taken[0][0]:
            snapshot = history.pop()
            later.append((snapshot.key, snapshot.event, -1))
        for key, event, place in merge(later[::-1], taken, key=lambda entry: entry[0]):
            assert event is not None
            snapshot, correction = take(config, history[-1], key, event)
            history.append(snapshot)
            if place >= 0:
                corrections[place] = correction
    oldest, first = history[-1].key[0] - config.history, 0
    while first + 1 < len(history) and history[first + 1].key[0] <= oldest:
        first += 1
    return FusionState(config, tuple(history[first:]), turned_away, ahead), corrections


def _too_late_or_early(
    config: FilterConfig, newest: float, oldest: float, ahead: _Ahead | None, stamp: float
) -> tuple[str, _Ahead | None]:
    """Why an event at this stamp cannot be taken ("": it can), and the run of stamps too far ahead that goes on.

    One wrong clock must not carry the filter off, a real gap must not stop it: so a far stamp is believed only after
    `gate_patience` others and `history` seconds of them, with nothing nearer in between.
    """
    lead = stamp - newest
    if lead < -config.history or stamp < oldest:
        return f"too late: {-lead:.3f} s behind, the history goes back {config.history:g} s", ahead
    if lead <= config.longest_prediction:
        return "", None
    if ahead is None or abs(stamp - ahead.newest) > config.longest_prediction:
        ahead = _Ahead(stamp, stamp, 0)
    ahead = _Ahead(ahead.first, max(stamp, ahead.newest), ahead.length + 1)
    if ahead.length > config.gate_patience and ahead.newest - ahead.first >= config.history:
        return "", None
    return f"too far ahead: {lead:.3f} s, the longest prediction is {config.longest_prediction:g} s", ahead
