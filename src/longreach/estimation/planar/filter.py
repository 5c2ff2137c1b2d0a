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
from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.ekf import CLONES, REFERENCE, SCALE
from longreach.estimation.planar.state import Belief, Correction, Event, PoseClone, Snapshot, Tally
from longreach.estimation.planar.update import take
from longreach.estimation.replay_buffer import Key, ReplayBuffer
from longreach.measurement import RelativePoseMeasurement


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """The filter's state: `buffer` ends with the present; `turned_away` counts by source what no history takes."""

    config: FilterConfig
    buffer: ReplayBuffer
    turned_away: Mapping[str, int] = field(default_factory=dict)

    @property
    def newest(self) -> Snapshot:
        """The present."""
        return self.buffer.newest.state

    @property
    def stamp(self) -> float:
        """Time of the newest event taken [s]."""
        return self.buffer.newest.key[0]

    @property
    def belief(self) -> Belief:
        """The belief at `stamp`."""
        return self.newest.belief

    @property
    def tallies(self) -> dict[str, Tally]:
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
    stamp: float, pose: Float[np.ndarray, "3"], pose_covariance: Float[np.ndarray, "3 3"] | None = None,
    config: FilterConfig | None = None,
) -> FilterState:  # fmt: skip
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
    finite = np.isfinite(stamp) and np.all(np.isfinite(mean)) and np.all(np.isfinite(P))
    if not (finite and np.linalg.eigvalsh(P[REFERENCE:, REFERENCE:])[0] >= -1e-12):
        raise EstimationError(
            "The filter must start at a finite stamp and pose, with a positive semidefinite covariance."
        )
    mean.flags.writeable = P.flags.writeable = False
    key = (float(stamp), -1, "")
    return FilterState(config, replay_buffer.init(key, Snapshot(key, mean, P)))


def step(state: FilterState, event: Event) -> tuple[FilterState, Correction]:
    """Take one measurement or pose clone, in the order of stamps or up to `history` seconds late."""
    state, corrections = steps(state, [event])
    if corrections:
        return state, corrections[-1]
    return state, Correction(event.stamp, event.source, "refused", "too far ahead: it waits for others to confirm it")


def steps(state: FilterState, events: Iterable[Event]) -> tuple[FilterState, list[Correction]]:
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
    return FilterState(config, buffer, turned_away), corrections
