"""The filter over any number of sources: measurements in the order of their stamps, late ones put where they belong.

State is a chain of snapshots, one after every event of the last `history` seconds. A late event goes back to the
newest snapshot before it and everything after is taken again (`replay_buffer`). What one event does: `update.take`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Float

from longreach.errors import EstimationError
from longreach.estimation import replay_buffer
from longreach.estimation.ekf import CLONES, REFERENCE, SCALE
from longreach.estimation.filter_config import FilterConfig
from longreach.estimation.gaussian import Belief
from longreach.estimation.replay_buffer import Key, ReplayBuffer
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


@dataclass(frozen=True, slots=True, eq=False)
class FusionState:
    """The filter's state: `buffer` ends with the present; `turned_away` counts by source what no history takes."""

    config: FilterConfig
    buffer: ReplayBuffer
    turned_away: Mapping[str, int] = field(default_factory=dict)

    @property
    def history(self) -> tuple[Snapshot, ...]:
        """The snapshots of the recent past, oldest first."""
        return tuple(entry.state for entry in self.buffer.entries)

    @property
    def newest(self) -> Snapshot:
        """The present."""
        return self.buffer.newest.state

    @property
    def stamp(self) -> float:
        """Time of the newest event taken [s]."""
        return self.buffer.newest.key[0]

    @property
    def clones(self) -> Mapping[str, Clone]:
        """The pose clone that relative poses of each source refer to."""
        return self.newest.clones

    @property
    def belief(self) -> Belief:
        """The belief at `stamp`."""
        return self.newest.belief

    def belief_at(self, stamp: float) -> Belief:
        """Return what is believed at a time [s], predicted where it is after the newest event."""
        newest = self.newest._replace(links=None)
        return (predicted(self.config, newest, (stamp, 0, "")) if stamp > self.stamp else newest).belief

    @property
    def counters(self) -> dict[str, Tally]:
        """What became of the measurements, by source."""
        tallies = dict(self.newest.tallies)
        for source, count in self.turned_away.items():
            tally = tallies.get(source, Tally())
            tallies[source] = tally._replace(refused=tally.refused + count)
        return tallies


def _key(event: Event) -> Key:
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
    key = (float(stamp), -1, "")
    return FusionState(config, replay_buffer.init(key, Snapshot(key, None, mean, P)))


def step(state: FusionState, event: Event) -> tuple[FusionState, Correction]:
    """Take one measurement or pose clone, in the order of stamps or up to `history` seconds late."""
    state, corrections = steps(state, [event])
    if corrections:
        return state, corrections[-1]
    return state, Correction(event.stamp, event.source, "refused", "too far ahead: it waits for others to confirm it")


def steps(state: FusionState, events: Iterable[Event]) -> tuple[FusionState, list[Correction]]:
    """Take several at once, with the result of `step` one after the other in order; what comes after is retaken once.

    The corrections are in the events' order, `in_order`. An event too far ahead has none until it is taken or refused.
    """
    config, turned_away = state.config, dict(state.turned_away)
    settings = replay_buffer.Settings(config.history, config.longest_prediction, config.gate_patience)
    ordered = [(_key(event), event) for event in in_order(events)]
    buffer, _, decided = replay_buffer.step(state.buffer, ordered, partial(take, config), settings)
    corrections: list[Correction] = []
    for _, event, correction, reason in decided:
        if reason:
            turned_away[event.source] = turned_away.get(event.source, 0) + 1
            correction = Correction(event.stamp, event.source, "refused", reason)
        corrections.append(correction)
    return FusionState(config, buffer, turned_away), corrections
