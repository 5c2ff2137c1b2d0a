"""The localizer: readings in, beliefs out, as they come, with late ones put where they belong.

    wheels, steps ← wheel.step(wheels, reading)                                  (3.21), (3.22)
    lidar, match  ← lidar.step(lidar, scan, prior from the wheels)
    local         ← take(local, steps, match, gyro)    in the frame odom         (3.27)-(3.29)
    global        ← take(global, the same, and fixes)  in the frame map

All four are one value, `Estimates`, after each reading. A reading that is late goes back to the value before it
(`estimation.replay_buffer`), so results do not depend on the order in which readings arrive, nor on how they are
divided into calls of `step`. A row is settled, and given out, once nothing that comes can change it any more.
Whoever estimates uses this one program: the robot's loop, the network server, ROS, and `longreach estimate`.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation import replay_buffer
from longreach.estimation.planar import filter as planar_filter
from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.measurement_models import planar_imu
from longreach.estimation.planar.state import Belief, Correction, Event, Keyframe, PoseClone, Snapshot, Tally
from longreach.estimation.planar.update import predicted, take
from longreach.estimation.replay_buffer import Decided, Entry, Key, ReplayBuffer
from longreach.geometry import se2
from longreach.localization import initial_pose
from longreach.localization.config import LocalizerConfig, Source, filter_for
from longreach.localization.initial_pose import Fixed
from longreach.measurement import (
    Imu,
    LaserScan,
    Odometry,
    PoseMeasurement,
    RelativePoseMeasurement,
    Wheels,
    WheelSpeeds,
    WheelTicks,
)
from longreach.odometry import dead_reckoning, lidar, wheel
from longreach.odometry.lidar import LidarState, ScanMatch
from longreach.odometry.wheel import WheelState
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator, description_of

__all__ = ["Localizer", "LocalizerConfig", "LocalizerState", "Output", "Reading", "Row", "init", "settled", "step"]

Reading = Wheels | LaserScan | Imu | PoseMeasurement

# The source of each kind of reading, and which goes first at one stamp: wheels, with which the others are compared.
_SOURCES: dict[type, tuple[int, Source]] = {
    WheelTicks: (0, "wheels"),
    WheelSpeeds: (0, "wheels"),
    Odometry: (0, "wheels"),
    Imu: (1, "imu"),
    PoseMeasurement: (2, "fixes"),
    LaserScan: (3, "lidar"),
}
_STEPS = 100  # of the wheels that are remembered for a scan to come: two seconds of them
_GYRO_LASTS = 1.0  # [s] without a reading, after which the heading is coupled to the wheels again
_RHYTHM = 200  # stamps from which it is learned how wrong they are, to 8 %: 1.2 / √200
_MORE, _CHANGED = 20, 0.2  # it is looked at anew after so many, and taken where it has changed by this part
_ROUNDING = 1e-4  # [s] that no clock of a sensor is better than


class Row(NamedTuple):
    """The estimate right after all that was measured up to a stamp [s]: pose (3,) and covariance (3, 3) of ξ."""

    stamp: float
    pose: np.ndarray
    covariance: np.ndarray


class Output(NamedTuple):
    """What a step gives out.

    rows, rows_on_map: what is settled in the frames odom and map, oldest first; matches, events: of the settled
    readings. corrections: what became of the new readings, at once; those of fixes are on the map.
    """

    rows: list[Row]
    rows_on_map: list[Row]
    matches: list[ScanMatch]
    events: list[Event]
    corrections: list[Correction]


class Estimates(NamedTuple):
    """What is known after a reading.

    settings: of the filters, with what is learned of stamps and gyro. local: the filter in the frame odom, None before
    the first reading; global_: in the frame map, None as long as nothing says where that is; fixed: the fixes until
    then. steps: the last ones of the wheels. dead_reckoned (3,): the pose by the wheels alone. rhythm: the last stamps
    of scans, else of wheels [s], and of which of the two. gyro: stamp of its last reading [s]. taken: readings so far.
    """

    settings: FilterConfig
    wheels: WheelState
    lidar: LidarState
    dead_reckoned: np.ndarray
    local: Snapshot | None = None
    global_: Snapshot | None = None
    fixed: tuple[Fixed, ...] = ()
    steps: tuple[RelativePoseMeasurement, ...] = ()
    rhythm: tuple[float, ...] = ()
    rhythm_of: Source = "wheels"
    gyro: float = -np.inf
    taken: int = 0


class _Taken(NamedTuple):
    """What came of one reading."""

    corrections: list[Correction]
    events: list[Event]
    match: ScanMatch | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LocalizerState:
    """The localizer with its recent past.

    turned_away: how many readings of each source were refused for their stamps.
    """

    robot: RobotDescription
    config: LocalizerConfig
    T_base_imu: Float[np.ndarray, "4 4"]
    start: Float[np.ndarray, "3"]
    start_on_map: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]] | None
    buffer: ReplayBuffer
    turned_away: dict[str, int]

    @property
    def now(self) -> Estimates:
        """What is known after the newest reading."""
        return self.buffer.newest.state

    @property
    def stamp(self) -> float:
        """Of the newest reading [s]; -inf before the first."""
        return self.buffer.newest.key[0]

    @property
    def tallies(self) -> dict[str, Tally]:
        """What became of the measurements, by source; fixes are counted on the map."""
        now = self.now
        tallies = dict(now.local.tallies) if now.local is not None else {}
        if now.global_ is not None:
            tallies |= {name: tally for name, tally in now.global_.tallies.items() if name not in tallies}
        for source, count in self.turned_away.items():
            tally = tallies.get(source, Tally())
            tallies[source] = tally._replace(refused=tally.refused + count)
        return tallies

    def belief(self, stamp: float | None = None) -> Belief:
        """Return what is believed in the smooth frame odom, which no fix moves.

        stamp [s]: predicted to where that is after the newest reading; None: as of that.
        """
        return _belief(self, self.now.local, stamp)

    def belief_on_map(self, stamp: float | None = None) -> Belief:
        """Return `belief` with the pose in the frame map; as long as nothing says where that is, it is odom."""
        return _belief(self, self.now.global_ or self.now.local, stamp)


def init(
    robot: RobotDescription,
    config: LocalizerConfig | None = None,
    start: Float[np.ndarray, "3"] | None = None,
    start_on_map: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]] | None = None,
    *,
    T_base_laser: Float[np.ndarray, "4 4"] | None = None,
    T_base_imu: Float[np.ndarray, "4 4"] | None = None,
) -> LocalizerState:
    """Start before the first reading, at rest.

    Arguments:
        start (3,): pose [m, m, rad] in the frame odom, which a run defines: it is exact there; None: the identity.
        start_on_map: pose (3,) and covariance (3, 3) of its ξ in the frame map, where they are known.
        T_base_laser, T_base_imu: where the sensors are; None: as the description says, else at the base.
    """
    config = config or LocalizerConfig()
    config = config.model_copy(update={"filter": filter_for(config, robot)})
    start = np.zeros(3) if start is None else np.array(start, dtype=float)
    mount = _mount(robot.lidar) if T_base_laser is None else T_base_laser
    buffer = replay_buffer.init((-np.inf, -1, ""), _initial(robot, config, start, mount))
    T_base_imu = _mount(robot.imu) if T_base_imu is None else T_base_imu
    return LocalizerState(robot, config, T_base_imu, start, start_on_map, buffer, {})


def _initial(robot: RobotDescription, config: LocalizerConfig, start: np.ndarray, mount: np.ndarray) -> Estimates:
    return Estimates(config.filter, wheel.init(robot, config.wheels), lidar.init(config.lidar, mount), start)


def step(state: LocalizerState, readings: Iterable[Reading]) -> tuple[LocalizerState, Output]:
    """Take readings in the order in which they arrived; of sources that are not fused nothing is taken."""
    config, keyed = state.config, list[tuple[Key, Reading]]()
    for reading in readings:
        order, source = _SOURCES[type(reading)]
        if config.sources is None or source in config.sources:
            keyed.append(((reading.stamp, order, ""), reading))
    limits = replay_buffer.Settings(
        config.filter.history, config.filter.longest_prediction, config.filter.gate_patience
    )
    buffer, entries, decided = replay_buffer.step(state.buffer, keyed, partial(_take, state), limits)
    corrections, turned_away = _corrections(decided, state.turned_away)
    rows = _rows([*entries, buffer.entries[0]])
    return replace(state, buffer=buffer, turned_away=turned_away), Output(*rows, *_come_of(entries), corrections)


def settled(state: LocalizerState) -> Output:
    """Return what is left at the end, when no reading comes any more."""
    entries = state.buffer.entries
    end = Entry((np.inf, 0, ""), None, None)
    return Output(*_rows([*entries, end]), *_come_of(entries), [])


def _mount(sensor) -> np.ndarray:
    return np.eye(4) if sensor is None or sensor.mount is None else sensor.mount.matrix()


def _belief(state: LocalizerState, newest: Snapshot | None, stamp: float | None) -> Belief:
    newest = newest or planar_filter.init(stamp or 0.0, state.start, None, state.now.settings).newest
    if stamp is not None and stamp > newest.key[0]:
        newest = predicted(state.now.settings, newest, (stamp, 0, ""))
    return newest.belief


def _corrections(decided: list[Decided], turned_away: dict[str, int]) -> tuple[list[Correction], dict[str, int]]:
    corrections: list[Correction] = []
    for key, reading, taken, reason in decided:
        if reason:
            source = reading.source if isinstance(reading, PoseMeasurement) else _SOURCES[type(reading)][1]
            corrections.append(Correction(key[0], source, "refused", reason))
            turned_away = {**turned_away, source: turned_away.get(source, 0) + 1}
        else:
            corrections += taken.corrections
    return corrections, turned_away


def _rows(entries: list[Entry]) -> tuple[list[Row], list[Row]]:
    """Return a row of each stamp, as of its last reading, of all entries but the last."""
    rows, on_map = list[Row](), list[Row]()
    for entry, after in pairwise(entries):
        stamp = entry.key[0]
        if after.key[0] > stamp and entry.event is not None:
            for filter_, into in ((entry.state.local, rows), (entry.state.global_, on_map)):
                if filter_ is not None and filter_.key[0] == stamp:
                    into.append(Row(stamp, *filter_.pose))
    return rows, on_map


def _come_of(entries: Iterable[Entry]) -> tuple[list[ScanMatch], list[Event]]:
    taken: list[_Taken] = [entry.outcome for entry in entries if entry.outcome is not None]
    return [t.match for t in taken if t.match is not None], [event for t in taken for event in t.events]


def _take(state: LocalizerState, before: Estimates, key: Key, reading: Reading) -> tuple[Estimates, _Taken]:
    """Take one reading: what it measures, and what the filters make of that."""
    _, source = _SOURCES[type(reading)]
    limit, local = state.config.filter, before.local
    far = local is not None and key[0] - local.key[0] > limit.longest_prediction
    if far and before.taken <= limit.gate_patience:  # those that confirm the later clock are more
        before = _initial(state.robot, state.config, state.start, before.lidar.T_base_laser)
    before = before._replace(taken=before.taken + 1)
    if before.local is None and not isinstance(reading, PoseMeasurement):  # which odom is to know nothing of
        before = _started(state, before, key[0])
    return _TAKE[source](state, before, key, reading)


def _started(state: LocalizerState, estimates: Estimates, stamp: float) -> Estimates:
    local = planar_filter.init(stamp, state.start, None, estimates.settings).newest
    known = state.start_on_map
    global_ = None if known is None else planar_filter.init(stamp, *known, estimates.settings).newest
    return estimates._replace(local=local, global_=global_)


def _filtered(now: Estimates, key: Key, events: list[Event]) -> tuple[Estimates, list[Correction]]:
    """Let both filters take what was measured. (3.27)-(3.29)"""
    local, global_, corrections = now.local, now.global_, list[Correction]()
    for event in events:
        local, correction = take(now.settings, local, key, event)  # type: ignore[arg-type]
        corrections.append(correction)
        if global_ is not None:
            global_, _ = take(now.settings, global_, key, event)
    return now._replace(local=local, global_=global_), corrections


def _wheels(state: LocalizerState, before: Estimates, key: Key, record: Wheels) -> tuple[Estimates, _Taken]:
    """Take a wheel record: the step that it ends, else a pose clone from where the next one goes on. (3.21), (3.22)"""
    wheels, steps = wheel.step(before.wheels, (record,))
    events: list[Event] = list(steps)
    is_taken = record.stamp in wheels.stamps[-1:] and record.stamp not in before.wheels.stamps[-1:]
    if is_taken and not (steps and steps[-1].reading_covariance is not None):
        events.append(PoseClone(record.stamp, "wheels"))
    pose = reduce(se2.compose, (one.pose for one in steps), before.dead_reckoned)
    now = before._replace(wheels=wheels, steps=(*before.steps, *steps)[-_STEPS:], dead_reckoned=pose)
    if before.rhythm_of == "wheels":
        now = _with_rhythm(state, now, "wheels", record.stamp)
    now, corrections = _filtered(_with_gyro(state, now, record.stamp), key, events)
    return now, _Taken(corrections, events)


def _scan(state: LocalizerState, before: Estimates, key: Key, scan: LaserScan) -> tuple[Estimates, _Taken]:
    """Match a scan, from where the wheels expect it; of several with one stamp the first."""
    if not scan.stamp > before.lidar.stamp:
        return before, _Taken([], [])
    known = np.isfinite(before.lidar.stamp)
    prior, found = (
        dead_reckoning.from_wheels(before.steps, before.lidar.stamp, scan.stamp) if known else None,
        before.lidar,
    )
    if found.variance.any() and before.local is not None:  # the last scan had no match
        found, prior = _lost_prior(found, predicted(before.settings, before.local, key), prior)
    odometry, match = lidar.step(found, scan, prior)
    events: list[Event] = [] if match.measurement is None else [match.measurement]
    if match.keyframe:
        events = [Keyframe(match.stamp, "lidar", match.measurement, match.keyframe_noise)]
    now = _with_rhythm(state, before._replace(lidar=odometry), "lidar", scan.stamp)
    now, corrections = _filtered(now, key, events)
    return now, _Taken(corrections, events, match if known or odometry is found else None)


def _lost_prior(
    odometry: lidar.LidarState, local: Snapshot, prior: np.ndarray | None
) -> tuple[lidar.LidarState, np.ndarray | None]:
    """Return LIDAR odometry and its prior as the filter has them: gyro and all know more than wheels after a while."""
    clone = local.clones.get("lidar")
    if clone is None or not clone.keyframe or clone.stamp != odometry.keyframe:
        return odometry, prior
    i, n = clone.at, len(local.mean)
    pose = se2.between(local.mean[i : i + 3], local.mean[:3])
    J = np.zeros((3, n))
    J[:, :3], J[:, i : i + 3] = np.eye(3), -se2.adjoint(se2.inverse(pose))
    expected = se2.compose(odometry.keyframe_pose, pose)
    variance = np.einsum("ij,jk,ik->i", J, local.P, J)
    return odometry._replace(variance=variance), se2.between(odometry.pose, expected)


def _imu(state: LocalizerState, before: Estimates, key: Key, imu: Imu) -> tuple[Estimates, _Taken]:
    """Take an IMU's reading, of an IMU that is described."""
    noise = state.robot.imu
    if noise is None:
        return before, _Taken([], [])
    with np.errstate(invalid="ignore"):  # the filter refuses what is not finite, and counts it
        event = planar_imu(imu, state.T_base_imu, noise.gyro_deviation**2, noise.acceleration_deviation**2)
    now, corrections = _filtered(before, key, [event])
    if corrections[0].status != "refused":
        now = now._replace(gyro=imu.stamp)
    return now, _Taken(corrections, [event])


def _fix(state: LocalizerState, before: Estimates, key: Key, fix: PoseMeasurement) -> tuple[Estimates, _Taken]:
    """Take an absolute pose: it tells where odom is on the map, and then corrects the estimate there alone."""
    global_ = before.global_
    if global_ is None:
        if not initial_pose.is_usable(fix):
            return before, _Taken([Correction(fix.stamp, fix.source, "refused", "it is not finite")], [])
        local = None if before.local is None else predicted(before.settings, before.local, key)
        fixed = (*before.fixed, Fixed(state.start if local is None else local.pose[0], fix))
        found = initial_pose.from_fixes(fixed)
        if local is None or found is None:
            said = Correction(fix.stamp, fix.source, "used")
            return before._replace(fixed=initial_pose.thinned(fixed)), _Taken([said], [fix])
        global_ = initial_pose.on_map(local, *found)
    global_, correction = take(before.settings, global_, key, fix)
    return before._replace(global_=global_, fixed=()), _Taken([correction], [fix])


_TAKE = {"wheels": _wheels, "lidar": _scan, "imu": _imu, "fixes": _fix}


def stamp_deviation(stamps: Float[np.ndarray, " n"]) -> float:
    """Return how far stamps [s] are off an even rhythm, as a standard deviation; 0 of fewer than 5.

    From the mean of |second differences|, √6 times as large for independent errors, without the two that a pause makes.
    (Their median is next to nothing where messages are held up and come all at once, as on the Intel log.)
    """
    if len(stamps) < 5:
        return 0.0
    usual = 4.0 * float(np.minimum(np.diff(stamps), 1.0).mean())  # no more than that is an error
    off = np.sort(np.minimum(np.abs(np.diff(stamps, 2)), usual))[:-2]
    return float(off.mean() * np.sqrt(np.pi / 12.0))


def _with_rhythm(state: LocalizerState, now: Estimates, source: Source, stamp: float) -> Estimates:
    """Learn how wrong stamps are from the rhythm of scans, or of wheels where there are none."""
    if state.config.filter.stamp_deviation is not None:
        return now
    rhythm = (*(now.rhythm if now.rhythm_of == source else ()), stamp)
    if len(rhythm) % _MORE == 0:
        sigma, known = stamp_deviation(np.array(rhythm)), now.settings.stamp_deviation or 0.0
        if abs(sigma - known) > _CHANGED * known + _ROUNDING:
            now = now._replace(settings=now.settings.changed(stamp_deviation=sigma))
    return now._replace(rhythm=rhythm[_MORE:] if len(rhythm) == _RHYTHM else rhythm, rhythm_of=source)


def _with_gyro(state: LocalizerState, now: Estimates, stamp: float) -> Estimates:
    """Couple the heading to the wheels only as long as there is no gyro, which knows better."""
    if state.config.filter.coupled_to_wheels is not None:
        return now
    alone = stamp - now.gyro > _GYRO_LASTS
    coupled = now.settings.coupled_to_wheels
    if coupled is not None and coupled[2] == alone:
        return now
    return now._replace(settings=now.settings.changed(coupled_to_wheels=(True, True, alone)))


class Localizer:
    """A localizer that holds its own state: `init` and `step` for a loop of your own.

    localizer = lr.Localizer(lr.load_robot("thing"))
    for reading in driver:           # LaserScan, WheelTicks, Imu, PoseMeasurement, ... in the order of arrival
        localizer.step(reading)
        belief = localizer.belief()  # pose, twist and covariance in the frame odom
    """

    def __init__(
        self,
        robot: RobotDescription | MobileManipulator,
        config: LocalizerConfig | None = None,
        start: Float[np.ndarray, "3"] | None = None,
        start_on_map: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]] | None = None,
    ) -> None:
        """Start before the first reading; the arguments are those of `init`."""
        self.state = init(description_of(robot), config, start, start_on_map)

    def step(self, *readings: Reading) -> Output:
        """Take readings; return what that has settled, and what became of them."""
        self.state, output = step(self.state, readings)
        return output

    def belief(self, stamp: float | None = None) -> Belief:
        """Return what is believed at a stamp [s], or after the newest reading, in the smooth frame odom."""
        return self.state.belief(stamp)

    def belief_on_map(self, stamp: float | None = None) -> Belief:
        """Return `belief` in the frame map."""
        return self.state.belief_on_map(stamp)
