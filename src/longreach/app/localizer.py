"""The estimate while the robot drives: what `estimate` does with a recording, reading by reading.

The same sources through the same filter, so that a replay of what was read gives the same rows: a row is settled, and
given out, once it is older than the filter's history, when nothing that comes late can change it any more.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.app.configuration import EstimateConfig, filter_for
from longreach.app.estimate import sensor_mount
from longreach.app.filter_events import match_events, wheel_events
from longreach.control.hardware import Readings
from longreach.estimation import fusion
from longreach.estimation.fusion import Correction, Event, FusionState
from longreach.estimation.gaussian import Belief
from longreach.estimation.observation import planar_imu
from longreach.measurement import LaserScan, PoseMeasurement, Recording, RelativePoseMeasurement, Wheels
from longreach.odometry import lidar, motion_prior, wheel
from longreach.odometry.lidar import LidarState
from longreach.odometry.wheel import WheelState
from longreach.robot.description import RobotDescription

_STEPS = 100  # of the wheels that are remembered: two seconds of them
_NOTHING = Recording("live")
_HISTORY = 0.5  # how late a measurement may come [s]: a scan's sweep and its way, many times over


class Row(NamedTuple):
    """The estimate right after all that was measured up to a stamp [s]: pose (3,) and covariance (3, 3) of ξ."""

    stamp: float
    pose: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class LocalizerState:
    """What the sources and the filters remember.

    filter: in the frame odom, which no fix moves. localized: with the fixes as well, in the frame map; None: no fixes.
    steps: the last of the wheels, for the scans that are to come. carried_to: stamp [s] of the encoder reading up to
    which the wheels' pose clone is carried.
    """

    robot: RobotDescription
    config: EstimateConfig
    filter: FusionState
    start: float
    wheels: WheelState
    lidar: LidarState
    T_base_imu: Float[np.ndarray, "4 4"]
    localized: FusionState | None = None
    steps: tuple[RelativePoseMeasurement, ...] = ()
    carried_to: float = -np.inf

    def belief(self, now: float) -> Belief:
        """Return what is believed at `now` [s], predicted from the newest measurement, in the smooth frame odom."""
        return self.filter.belief_at(now)

    def belief_on_map(self, now: float) -> Belief:
        """Return what is believed at `now` [s] with the pose in the frame map; without fixes it is odom."""
        return (self.localized or self.filter).belief_at(now)


def init(
    robot: RobotDescription,
    stamp: float,
    pose: Float[np.ndarray, "3"],
    config: EstimateConfig | None = None,
    on_map: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]] | None = None,
) -> LocalizerState:
    """Start at rest at a pose [m, m, rad] in the frame odom, which a run defines; it is exact there.

    on_map: pose and covariance in the frame map, where they are known; until the first fix map is odom otherwise.
    """
    config = config or EstimateConfig()
    chosen = filter_for(config, robot, _NOTHING)
    gyro = robot.imu is not None and (config.sources is None or "imu" in config.sources)
    set_ = "coupled_to_wheels" in config.filter.model_fields_set
    coupled = {} if set_ else {"coupled_to_wheels": (True, True, not gyro)}
    chosen = chosen.model_copy(update={"history": _HISTORY, **coupled})
    matcher = lidar.init(config.lidar, sensor_mount(_NOTHING, robot, "lidar"))
    T_base_imu = sensor_mount(_NOTHING, robot, "imu")
    start = fusion.init(stamp, pose, None, chosen)
    localized = None if on_map is None else fusion.init(stamp, *on_map, chosen)
    odometry = wheel.init(robot, config.wheels)
    return LocalizerState(robot, config, start, stamp, odometry, matcher, T_base_imu, localized)


def oldest(readings: Readings, config: EstimateConfig) -> float:
    """Return the stamp [s] of the oldest reading that is fused, with which an estimate begins."""
    kinds = {"wheels": readings.wheels, "lidar": readings.scans, "imu": readings.imu}
    used = [records for source, records in kinds.items() if config.sources is None or source in config.sources]
    return min((record.stamp for records in used for record in records), default=readings.stamp)


def step(
    state: LocalizerState, readings: Readings, fixes: Sequence[PoseMeasurement] = ()
) -> tuple[LocalizerState, list[Correction]]:
    """Take all that was read, and absolute poses; what no source can use is refused by the filter, which says so."""
    sources = state.config.sources or ("wheels", "lidar", "imu", "fixes")
    fixes, events = fixes if "fixes" in sources else (), list[Event]()
    if "imu" in sources and state.robot.imu is not None and readings.imu:
        noise = state.robot.imu
        R = (noise.gyro_deviation**2, noise.acceleration_deviation**2)
        events += [planar_imu(imu, state.T_base_imu, *R) for imu in readings.imu]
    if "wheels" in sources and readings.wheels:
        state, measured = _wheels(state, readings.wheels)
        events += measured
    if "lidar" in sources:
        for scan in readings.scans:
            state, measured = _lidar(state, scan)
            events += measured
    fused, corrections = fusion.steps(state.filter, events)
    localized = state.localized or (state.filter if fixes else None)  # until the first fix, map is odom
    if localized is not None:
        localized, judged = fusion.steps(localized, [*events, *fixes])
        names = {fix.source for fix in fixes}
        corrections += [correction for correction in judged if correction.source in names]
    return replace(state, filter=fused, localized=localized), corrections


def settled(before: LocalizerState, after: LocalizerState | None) -> list[Row]:
    """Return the rows in the frame odom that a step has settled, oldest first; after it has ended (None), all left."""
    return _settled(before.filter, None if after is None else after.filter)


def settled_on_map(before: LocalizerState, after: LocalizerState | None) -> list[Row]:
    """Return `settled` in the frame map; without fixes it is odom."""
    newest = None if after is None else after.localized or after.filter
    return _settled(before.localized or before.filter, newest)


def _settled(before: FusionState, after: FusionState | None) -> list[Row]:
    oldest = np.inf if after is None else after.history[0].key[0]
    rows: dict[float, Row] = {}
    for snapshot in before.history:
        stamp = snapshot.key[0]
        if stamp < oldest and snapshot.event is not None:
            rows[stamp] = Row(stamp, *snapshot.pose)
    return list(rows.values())


def _wheels(state: LocalizerState, records: tuple[Wheels, ...]) -> tuple[LocalizerState, list[Event]]:
    """Turn new wheel records into steps of the wheel odometry; those that begin before the start are left out."""
    wheels, found = wheel.step(state.wheels, records)
    new = tuple(step for step in found if step.stamp_reference >= state.start)
    events = wheel_events(new, state.carried_to)
    carried_to = state.carried_to
    if new:
        carried_to = -np.inf if new[-1].reading_covariance is None else new[-1].stamp
    steps = (*state.steps, *new)[-_STEPS:]
    return replace(state, wheels=wheels, steps=steps, carried_to=carried_to), events


def _lidar(state: LocalizerState, scan: LaserScan) -> tuple[LocalizerState, list[Event]]:
    """Match a scan, from where the wheels expect it if they are fused; one from before the start is passed over."""
    if not scan.stamp > max(state.lidar.stamp, np.nextafter(state.start, -np.inf)):
        return state, []
    known = np.isfinite(state.lidar.stamp)
    prior = motion_prior.from_wheels(state.steps, state.lidar.stamp, scan.stamp) if known else None
    odometry, match = lidar.step(state.lidar, scan, prior)
    return replace(state, lidar=odometry), match_events(match)
