"""The filter over any number of sources: measurements in the order of their stamps, late ones put where they belong.

State is a chain of snapshots, one after every event of the last `history` seconds. A late event goes back to the
newest snapshot before it and everything after is taken again, so that the result is that of sorted input.
`step` reads as the method: predict to the stamp (3.28), observe, gate, correct (3.29).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import EstimationError
from longreach.estimation import ekf
from longreach.estimation.filter_config import FilterConfig
from longreach.estimation.gaussian import Belief
from longreach.estimation.observation import Measurement, observe
from longreach.measurement import RelativePoseMeasurement

_NOTHING = np.zeros(0)
_NOTHING.flags.writeable = False


@dataclass(frozen=True, slots=True)
class Anchor:
    """From here on, relative poses of `source` refer to the pose at `stamp`, which the filter remembers (a clone)."""

    stamp: float
    source: str

    def __post_init__(self) -> None:
        if not np.isfinite(self.stamp):
            raise EstimationError(f"An Anchor has the stamp {self.stamp}; a stamp is a finite number of seconds.")


Event = Measurement | Anchor


class Tally(NamedTuple):
    """What became of one source's measurements; `used` counts the `inflated` ones too."""

    used: int = 0
    inflated: int = 0
    gated: int = 0
    refused: int = 0
    streak: int = 0  # beyond the gate in a row


class Correction(NamedTuple):
    """What became of one event. An Anchor has dof 0; so has what was refused before it could be compared (nis 0)."""

    stamp: float
    source: str
    status: Literal["used", "gated", "refused"]
    reason: str = ""
    innovation: Float[np.ndarray, " k"] = _NOTHING
    nis: float = 0.0
    dof: int = 0


class Snapshot(NamedTuple):
    """The filter after one event (None: the start): mean (10 + 3m,), P, anchors as source → (number, stamp)."""

    key: tuple[float, int, str]
    event: Event | None
    mean: np.ndarray
    P: np.ndarray
    anchors: Mapping[str, tuple[int, float]]
    tallies: Mapping[str, Tally]


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
    def anchors(self) -> Mapping[str, tuple[int, float]]:
        """Number and stamp [s] of the anchor of each source."""
        return self.history[-1].anchors

    @property
    def belief(self) -> Belief:
        """The belief at `stamp`."""
        return _belief(self.stamp, self.history[-1].mean, self.history[-1].P)

    @property
    def counters(self) -> dict[str, Tally]:
        """What became of the measurements, by source."""
        tallies = dict(self.history[-1].tallies)
        for source, count in self.turned_away.items():
            tally = tallies.get(source, Tally())
            tallies[source] = tally._replace(refused=tally.refused + count)
        return tallies


def _belief(stamp: float, mean: np.ndarray, P: np.ndarray) -> Belief:
    return Belief(stamp, mean[:3], mean[3:6], mean[6:9], float(mean[9]), P[:10, :10])


def _key(event: Event) -> tuple[float, int, str]:
    """Order of events at one stamp: a counter's step first, which tells the others where to look.

    An anchor comes last, so that what refers to the former anchor still finds it.
    """
    steps = isinstance(event, RelativePoseMeasurement) and event.reading_covariance is not None
    return event.stamp, 2 if isinstance(event, Anchor) else 0 if steps else 1, event.source


def in_order(events: Iterable[Event]) -> list[Event]:
    """Sort events as the filter takes them."""
    return sorted(events, key=_key)


def init(
    stamp: float,
    pose: Float[np.ndarray, "3"],
    pose_covariance: Float[np.ndarray, "3 3"] | None = None,
    config: FilterConfig | None = None,
) -> FusionState:
    """Start at a pose [m, m, rad], at rest as far as is known.

    pose_covariance of ξ = log(mean⁻¹ · truth); None: the pose is exact, as where a run defines its own frame.
    """
    config = config or FilterConfig()
    mean, P = np.zeros(10), np.zeros((10, 10))
    mean[:3] = pose
    if pose_covariance is not None:
        P[:3, :3] = pose_covariance
    P[3:6, 3:6] = np.diag(np.square(config.initial_twist_deviation))
    P[6:9, 6:9] = np.diag(config.motion.acceleration_variance)
    P[9, 9] = config.initial_gyro_bias_deviation**2
    if not (
        np.isfinite(stamp)
        and np.all(np.isfinite(mean))
        and np.all(np.isfinite(P))
        and np.linalg.eigvalsh(P[:3, :3])[0] >= -1e-12
    ):
        raise EstimationError(
            "The filter must start at a finite stamp and pose, with a positive semidefinite covariance."
        )
    mean.flags.writeable = P.flags.writeable = False
    return FusionState(config, (Snapshot((float(stamp), -1, ""), None, mean, P, {}, {}),))


def step(state: FusionState, event: Event) -> tuple[FusionState, Correction]:
    """Take one measurement or anchor, in the order of stamps or up to `history` seconds late."""
    reason, ahead = _at_the_door(state, event.stamp)
    if reason:
        turned_away = {**state.turned_away, event.source: state.turned_away.get(event.source, 0) + 1}
        return replace(state, turned_away=turned_away, ahead=ahead), Correction(
            event.stamp, event.source, "refused", reason
        )
    history, key = state.history, _key(event)
    place = len(history)
    while place > 1 and history[place - 1].key > key:
        place -= 1
    snapshot, correction = _take(state.config, history[place - 1], key, event)
    if place == len(history):
        history = (*history, snapshot)
    else:
        retaken = [*history[:place], snapshot]
        for later in history[place:]:
            assert later.event is not None
            retaken.append(_take(state.config, retaken[-1], later.key, later.event)[0])
        history = tuple(retaken)
    oldest = history[-1].key[0] - state.config.history
    first = 0
    while first + 1 < len(history) and history[first + 1].key[0] <= oldest:
        first += 1
    return FusionState(state.config, history[first:], state.turned_away, ahead), correction


def _at_the_door(state: FusionState, stamp: float) -> tuple[str, _Ahead | None]:
    """Why an event at this stamp cannot be taken ("": it can), and the run of stamps too far ahead that goes on.

    One wrong clock must not carry the filter off, a real gap must not stop it: so a far stamp is believed only after
    `gate_patience` others and `history` seconds of them, with nothing nearer in between.
    """
    config = state.config
    lead = stamp - state.stamp
    if lead < -config.history or stamp < state.history[0].key[0]:
        return f"too late: {-lead:.3f} s behind, the history goes back {config.history:g} s", state.ahead
    if lead <= config.longest_prediction:
        return "", None
    ahead = state.ahead
    if ahead is None or abs(stamp - ahead.newest) > config.longest_prediction:
        ahead = _Ahead(stamp, stamp, 0)
    ahead = _Ahead(ahead.first, max(stamp, ahead.newest), ahead.length + 1)
    if ahead.length > config.gate_patience and ahead.newest - ahead.first >= config.history:
        return "", None
    return f"too far ahead: {lead:.3f} s, the longest prediction is {config.longest_prediction:g} s", ahead


def _take(
    config: FilterConfig, before: Snapshot, key: tuple[float, int, str], event: Event
) -> tuple[Snapshot, Correction]:
    """Predict to the event's stamp, then place the anchor or correct by the measurement."""
    mean, P, original = before.mean, before.P, event
    dt = float(key[0] - before.key[0])
    if dt > 0.0:
        mean, P = ekf.predict(config.motion, mean, P, dt)  # (3.28)
    if isinstance(event, Anchor):
        number = before.anchors.get(event.source, (len(before.anchors), 0.0))[0]
        anchors = {**before.anchors, event.source: (number, event.stamp)}
        after = Snapshot(key, event, *ekf.clone(mean, P, number), anchors, before.tallies)
        return after, Correction(event.stamp, event.source, "used")
    tally, anchors = before.tallies.get(event.source, Tally()), before.anchors
    if isinstance(event, RelativePoseMeasurement):
        mean, P, anchors, event = _carried(config, anchors, mean, P, event)
    mean, P, tally, correction = _correct(config, anchors, mean, P, tally, event)
    return Snapshot(key, original, mean, P, anchors, {**before.tallies, event.source: tally}), correction


def _carried(
    config: FilterConfig,
    anchors: Mapping[str, tuple[int, float]],
    mean: np.ndarray,
    P: np.ndarray,
    step: RelativePoseMeasurement,
) -> tuple[np.ndarray, np.ndarray, Mapping[str, tuple[int, float]], RelativePoseMeasurement]:
    """Take a step between two readings of a counter: the anchor goes along, and stands where the counter says we are.

    So the error of a reading stays with that reading, whereas the error of the steps adds up in the anchor. Returns
    what is left to measure: that we are at the anchor, as well as a reading tells. What is no such step stays as it is.
    """
    number, placed = anchors.get(step.source, (0, None))
    R = step.reading_covariance
    if R is None or placed != step.stamp_reference or not np.all(np.isfinite(step.pose)):
        return mean, P, anchors, step
    mean, P = ekf.carry(mean, P, number, step.pose, step.covariance, config.led)
    anchors = {**anchors, step.source: (number, step.stamp)}
    at_anchor = RelativePoseMeasurement(step.stamp, step.stamp, np.zeros(3), R, step.source)
    return mean, P, anchors, at_anchor


def _correct(
    config: FilterConfig,
    anchors: Mapping[str, tuple[int, float]],
    mean: np.ndarray,
    P: np.ndarray,
    tally: Tally,
    measurement: Measurement,
) -> tuple[np.ndarray, np.ndarray, Tally, Correction]:
    """Observe, gate, correct (3.29), and count."""
    stamp, source = measurement.stamp, measurement.source
    number = None
    if isinstance(measurement, RelativePoseMeasurement):
        number, placed = anchors.get(source, (None, None))
        if placed != measurement.stamp_reference:
            reason = f"relative to {measurement.stamp_reference} s, where {source} has no anchor"
            return mean, P, _refused(tally), Correction(stamp, source, "refused", reason)
    (r, H, R), fault = observe(mean, measurement, number)
    if fault:
        return mean, P, _refused(tally), Correction(stamp, source, "refused", fault)
    k = len(r)
    gate = config.gates[k - 1]
    inflate = config.gate_mode == "inflate" or tally.streak >= config.gate_patience
    mean, P, nis, scale = ekf.correct(mean, P, r, H, R, gate, inflate)
    if nis == np.inf:
        reason = "its innovation has no positive definite covariance"
        return mean, P, _refused(tally), Correction(stamp, source, "refused", reason)
    used, inflated, gated, refused, streak = tally
    if scale == 0.0:
        reason = f"NIS {nis:.1f} is above the gate {gate:.1f}"
        return (
            mean,
            P,
            Tally(used, inflated, gated + 1, refused, streak + 1),
            Correction(stamp, source, "gated", reason, r, nis, k),
        )
    if scale == 1.0:
        return mean, P, Tally(used + 1, inflated, gated, refused), Correction(stamp, source, "used", "", r, nis, k)
    reason = f"NIS {nis:.1f} is above the gate {gate:.1f}: taken with its covariance times {scale:.3g}"
    tally = Tally(used + 1, inflated + 1, gated, refused, streak + 1)
    return mean, P, tally, Correction(stamp, source, "used", reason, r, nis, k)


def _refused(tally: Tally) -> Tally:
    return tally._replace(refused=tally.refused + 1)
