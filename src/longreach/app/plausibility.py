"""Do the sources of an estimate agree? Their motions held against each other over the whole run.

Wheels, gyro and scans each say how far the base turned, wheels and scans how far it went. Noise makes them differ a
little; a swapped wheel, a wrong unit, a mount or a clock makes one differ from the others all along, which no
covariance covers. What is at fault follows from who agrees with whom.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from longreach.estimation.planar.measurement_models import PlanarImu
from longreach.estimation.planar.state import Correction, Event
from longreach.geometry import se2
from longreach.measurement import Recording, RelativePoseMeasurement
from longreach.odometry.lidar import ScanMatch

Name = Literal["wheels", "lidar", "imu"]
_Pair = tuple[Name, Name]
NAMES: Mapping[str, str] = {"wheels": "the wheels", "lidar": "the scans", "imu": "the gyro"}

_WINDOW = 0.4  # [s] over which motions are compared: two scans of a slow scanner
_TURNED, _GONE = 2.0, 1.0  # [rad, m] that a run has to show before sources are judged by it
_FEWEST = 12  # windows
# Share by which sources may differ: of wheels, which scrub and slip, the turn, the way; of a gyro.
_WHEELS_TURN, _WHEELS_WAY, _GYRO = 0.5, 0.3, 0.15
_AGREE = 0.6  # correlation below which sources have nothing to do with each other
_ASKEW = np.radians(10.0)  # between the directions in which wheels and scans go
_ASIDE = 0.05  # [m] that a laser may stand off where it is taken to be
_ALIKE = 0.97  # correlation that sources reach whose clocks differ; wheels lead on ice, with up to 0.94
_SURE = 5.0  # standard errors beyond those: a false alarm in 2 million runs of independent windows
_LATE, _LATEST, _RATE = 0.25, 4.0, 20.0  # [s, s, Hz] of clocks that differ
_CLEARER = 3.0  # by which what the sources do not have in common has to be less there than without
_LOOKED_AT, _REMEMBERED = 10.0, 120.0  # [s] between looks while it runs, and for how long motions are kept for them
_UNITS = {"its sign": -1.0, "degrees": 180.0 / np.pi, "degrees and its sign": -180.0 / np.pi}


class Motions(NamedTuple):
    """What one source says of the motion: stamps (n,) [s], heading (n,) [rad] and, of wheels and scans, way (n, 2) [m].

    Both are summed up over its steps; the way in the base's axes of each step. gaps (n,): how many steps were missing.
    """

    stamps: np.ndarray
    heading: np.ndarray
    way: np.ndarray | None
    gaps: np.ndarray


class Fault(NamedTuple):
    """A source that contradicts the others: what would put it right, if anything, and the sentence.

    mend: turn: its turns are `by` times too large. shift: its stamps are `by` [s] late. flip: its scans are mirrored.
    mount: it stands at `mount` (3,) of where it was taken to stand. leave: nothing puts it right. note: it is not
    clear which source it is, so nothing is done.
    """

    source: Name
    mend: Literal["turn", "shift", "flip", "mount", "leave", "note"]
    remark: str
    by: float = 1.0
    mount: np.ndarray = np.zeros(3)


class _Ratio(NamedTuple):
    """Of two sources' turns: how many times as far the first one turns, its standard error, and the correlation."""

    k: float
    error: float
    correlation: float


def mended(recording: Recording, found: Fault) -> Recording:
    """Return the recording with what a source has wrong put right."""
    if found.mend == "turn":
        turned = (replace(one, angular_velocity=one.angular_velocity / found.by) for one in recording.imu)
        return recording.replace(imu=tuple(turned))
    if found.mend == "shift":
        kind = {"wheels": "wheels", "lidar": "scans", "imu": "imu"}[found.source]
        readings = getattr(recording, kind)
        return recording.replace(**{kind: tuple(replace(one, stamp=one.stamp - found.by) for one in readings)})
    if found.mend == "flip":
        flipped = (replace(s, angle_min=-s.angle_min, angle_increment=-s.angle_increment) for s in recording.scans)
        return recording.replace(scans=tuple(flipped))
    if found.mend == "mount":
        mounts = dict.fromkeys({scan.frame for scan in recording.scans}, se2.to_se3(found.mount))
        return recording.replace(mounts={**recording.mounts, **mounts})
    return recording


def motions(matches: Sequence[ScanMatch], events: Sequence[Event]) -> dict[Name, Motions]:
    """Return what each source says of the motion, of those that are there."""
    found: dict[Name, Motions] = {}
    scans = [(m.stamp, m.motion) for m in matches if m.reason != "the scan is the first"]
    steps = [e for e in events if isinstance(e, RelativePoseMeasurement) and e.source == "wheels"]
    gyro = [e for e in events if isinstance(e, PlanarImu)]
    if len(scans) > 1:
        twists = [None if motion is None else se2.log(motion) for _, motion in scans]
        found["lidar"] = _summed([stamp for stamp, _ in scans], twists)
    if len(steps) > 1:
        missing = {i for i, (a, b) in enumerate(pairwise(steps)) if b.stamp_reference != a.stamp}
        twists = [None if i - 1 in missing else se2.log(step.pose) for i, step in enumerate(steps)]
        found["wheels"] = _summed([step.stamp for step in steps], twists)
    if len(gyro) > 1:
        stamps, rates = np.array([e.stamp for e in gyro]), np.array([e.rate for e in gyro])
        turns = np.append(0.0, np.cumsum(np.diff(stamps) * 0.5 * (rates[1:] + rates[:-1])))
        gaps = np.append(0, np.cumsum(np.diff(stamps) > _WINDOW))
        found["imu"] = Motions(stamps, turns, None, gaps)
    return found


class Recent:
    """The contradictions of the last two minutes while an estimate runs: what has settled is looked at now and then."""

    def __init__(self) -> None:
        self.remark = ""
        self._matches: deque[ScanMatch] = deque()
        self._events: deque[Event] = deque()
        self._looked = -np.inf

    def take(self, matches: Sequence[ScanMatch], events: Sequence[Event], mount_is_known: bool) -> bool:
        """Take what has settled; return whether `remark`, the newest contradiction or "", has changed."""
        self._matches.extend(matches)
        self._events.extend(events)
        newest = self._events[-1].stamp if self._events else -np.inf
        if newest - self._looked < _LOOKED_AT:
            return False
        self._looked = newest
        for kept in (self._matches, self._events):
            while kept and kept[0].stamp < newest - _REMEMBERED:
                kept.popleft()
        found = fault(motions(self._matches, self._events), mount_is_known)
        before, self.remark = self.remark, "" if found is None else found.remark
        return (before == "") != (found is None)


def _summed(stamps: Sequence[float], twists: Sequence[np.ndarray | None]) -> Motions:
    xi = np.array([np.zeros(3) if twist is None else twist for twist in twists])
    gaps = np.cumsum([twist is None for twist in twists])
    total = np.cumsum(xi, axis=0)
    return Motions(np.array(stamps), total[:, 2], total[:, :2], gaps)


def fault(said: Mapping[Name, Motions], mount_is_known: bool) -> Fault | None:
    """Return the gravest contradiction between sources, or None where they agree as far as the run shows."""
    late = _late(said)
    if late is not None:
        return late
    pairs: list[_Pair] = [("imu", "lidar"), ("imu", "wheels"), ("wheels", "lidar")]
    turns = {pair: _turns(said[pair[0]], said[pair[1]]) for pair in pairs if said.keys() >= set(pair)}
    wrong = {pair for pair, ratio in turns.items() if ratio is not None and _contradicts(pair, ratio)}
    if wrong:
        return _odd_one(turns, wrong, said)
    if "wheels" in said and "lidar" in said:
        return _ways(said["wheels"], said["lidar"], mount_is_known)
    return None


def _windows(*said: Motions) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of windows (n,) [s] that all sources cover, and which of the n - 1 windows have no gap."""
    stamps = min((one.stamps for one in said), key=len)
    start, end = max(one.stamps[0] for one in said), min(one.stamps[-1] for one in said)
    stamps = stamps[(stamps >= start) & (stamps <= end)]
    kept, last = list[float](), -np.inf
    for stamp in stamps.tolist():
        if stamp - last >= _WINDOW:
            kept.append(stamp)
            last = stamp
    ends = np.array(kept)
    whole = np.diff(ends) < 4.0 * _WINDOW
    for one in said:
        after = np.searchsorted(one.stamps, ends[1:], side="left").clip(max=len(one.gaps) - 1)
        before = np.searchsorted(one.stamps, ends[:-1], side="right").clip(min=1) - 1
        whole &= one.gaps[after] == one.gaps[before]
    return ends, whole


def _turns(a: Motions, b: Motions) -> _Ratio | None:
    """Compare the turns of two sources; None where the run shows too few. A gyro's bias is a constant of the fit."""
    ends, whole = _windows(a, b)
    if np.count_nonzero(whole) < _FEWEST:
        return None
    x, y = (np.diff(np.interp(ends, one.stamps, one.heading))[whole] for one in (b, a))
    dt = np.diff(ends)[whole]
    if min(np.abs(x - dt * x.sum() / dt.sum()).sum(), np.abs(y).sum()) < _TURNED and np.abs(x).sum() < _TURNED:
        return None
    A = np.column_stack([x, dt])
    (k, bias), *_ = np.linalg.lstsq(A, y, rcond=None)
    e = y - A @ np.array([k, bias])
    y, x = y - bias * dt, x
    size = float(np.sqrt((x @ x) * (y @ y)))
    if size <= 0.0:
        return None
    error = float(np.sqrt(e @ e / max(len(x) - 2, 1) / (x @ x)))
    return _Ratio(float(k), error, float(x @ y) / size)


def _contradicts(pair: _Pair, ratio: _Ratio) -> bool:
    bound = _WHEELS_TURN if "wheels" in pair else _GYRO
    if abs(ratio.correlation) < _AGREE:
        return True
    off = max(ratio.k - 1.0 - bound, 1.0 / (1.0 + bound) - ratio.k)
    return off > _SURE * ratio.error


def _odd_one(turns: Mapping[_Pair, _Ratio | None], wrong: set[_Pair], said: Mapping[Name, Motions]) -> Fault:
    """Say which source it is whose turns are wrong: the one that contradicts both others, else by what is likelier.

    Scans that match each other are evidence of their own, so of two sources it is not the LIDAR; a gyro knows its own
    scale better than wheels, which scrub.
    """
    accused = {name: sum(name in pair for pair in wrong) for name in said}
    right = {pair for pair, ratio in turns.items() if ratio is not None and pair not in wrong}
    known = len(said) == 3 and len(right) == 1 and len(wrong) == 2
    order: tuple[Name, ...] = ("wheels", "imu", "lidar")
    source = max(order, key=lambda name: accused.get(name, -1))
    if not known and len(said) == 3 and accused.get("imu", 0) > accused.get("wheels", 0):
        source = "imu"
    pair = next(pair for pair in sorted(wrong) if source in pair)
    ratio = turns[pair]
    assert ratio is not None
    other = pair[1] if pair[0] == source else pair[0]
    k = ratio.k if pair[0] == source else 1.0 / ratio.k
    others = " and ".join(NAMES[name] for name in said if name != source) if known else NAMES[other]
    say = f"{NAMES[source].capitalize()} turn{'s' if source == 'imu' else ''} {k:.3g} times as far as {others}"
    if abs(ratio.correlation) < _AGREE:
        say = f"The turns of {NAMES[source]} have nothing to do with those of {others} "
        say += f"(correlation {ratio.correlation:.2f})"
    if not known and "lidar" not in said:
        return Fault(source, "note", f"{say}; which of them is wrong cannot be seen here, so both were used.")
    if source == "imu" and abs(ratio.correlation) >= _AGREE:
        for what, unit in _UNITS.items():
            if abs(k / unit - 1.0) < _GYRO + _SURE * abs(ratio.error / ratio.k):
                return Fault(source, "turn", f"{say}; {what} was put right.", unit)
    if source == "lidar" and known and abs(k + 1.0) < _GYRO:
        return Fault(source, "flip", f"{say}: the LIDAR is upside down; it was taken so.")
    return Fault(source, "leave", f"{say}; {NAMES[source]} {'was' if source == 'imu' else 'were'} left out.")


def _ways(wheels: Motions, scans: Motions, mount_is_known: bool) -> Fault | None:
    """Compare how far and in which direction wheels and scans go. Motions are complex numbers here, x + iy.

    A laser at l, turned by φ, moves by m where the base moves by v and turns by ω: e^{iφ} m = v + iω l.
    """
    ends, whole = _windows(wheels, scans)
    if np.count_nonzero(whole) < _FEWEST:
        return None
    assert wheels.way is not None
    assert scans.way is not None
    v, m = (np.diff(np.interp(ends, s.stamps, s.way @ np.array([1.0, 1.0j])))[whole] for s in (wheels, scans))
    gone = float(np.abs(v).sum()), float(np.abs(m).sum())
    if max(gone) < _GONE or min(gone) <= 0.0:
        return None
    k = complex(np.vdot(m, v) / np.vdot(m, m))
    correlation = float(abs(np.vdot(m, v)) / np.sqrt(np.vdot(v, v).real * np.vdot(m, m).real))
    size, askew = abs(k), float(np.angle(k))
    error = float(np.sqrt(np.mean(np.abs(v - k * m) ** 2) / np.sum(np.abs(m) ** 2)))
    if not mount_is_known:
        turn = np.diff(np.interp(ends, scans.stamps, scans.heading))[whole]
        found = _mount(v, m, turn)
        if found is not None:
            return found
    if correlation < _AGREE:
        say = f"The wheels go {gone[0]:.1f} m and the scans {gone[1]:.1f} m, but not together "
        return Fault("wheels", "leave", say + f"(correlation {correlation:.2f}); the wheels were left out.")
    if abs(askew) > _ASKEW + _SURE * error / size:
        say = f"The wheels go {np.degrees(askew):.0f}° aside of the scans: the LIDAR's mount or the wheels' sense is "
        return Fault("wheels", "leave", say + "wrong; the wheels were left out.")
    if max(size - 1.0 - _WHEELS_WAY, 1.0 / (1.0 + _WHEELS_WAY) - size) > _SURE * error:
        return Fault("wheels", "leave", f"The wheels go {size:.3g} times as far as the scans; they were left out.")
    return None


def _mount(v: np.ndarray, m: np.ndarray, turn: np.ndarray) -> Fault | None:
    """Find where a laser stands of which nothing is known, by the wheels; None: as it was taken to, or not seen."""
    A = np.column_stack([m, -1j * turn])
    if np.linalg.cond(A) > 1e3 or np.abs(turn).sum() < _TURNED:
        return None
    (p, at), *_ = np.linalg.lstsq(A, v, rcond=None)
    e = v - A @ np.array([p, at])
    if not abs(abs(p) - 1.0) < _WHEELS_WAY or np.vdot(e, e).real > 0.2 * np.vdot(v, v).real:
        return None
    errors = np.sqrt(np.vdot(e, e).real / len(v) * np.linalg.inv((A.conj().T @ A).real).diagonal())
    yaw = float(np.angle(p))
    if abs(yaw) < _ASKEW + _SURE * errors[0] and abs(at) < _ASIDE + _SURE * errors[1]:
        return None
    say = f"By the wheels' motion the LIDAR stands at ({at.real:.2f}, {at.imag:.2f}) m in the base, turned by "
    say += f"{np.degrees(yaw):.0f}°; it was taken to. Give lidar.mount in the robot's description."
    return Fault("lidar", "mount", say, mount=np.array([at.real, at.imag, yaw]))


def _late(said: Mapping[Name, Motions]) -> Fault | None:
    """Find a source whose clock is off, from when the turns are most alike."""
    pairs: list[_Pair] = [("imu", "wheels"), ("lidar", "wheels"), ("lidar", "imu")]
    delays = {(a, b): _delay(said[a], said[b]) for a, b in pairs if a in said and b in said}
    off = {pair: delay for pair, delay in delays.items() if delay is not None}
    if not off:
        return None
    accused = {name: sum(name in pair for pair in off) for name in said}
    order: tuple[Name, ...] = ("lidar", "imu", "wheels")
    source = max(order, key=lambda name: accused.get(name, -1))
    pair = next(pair for pair in sorted(off) if source in pair)
    delay = off[pair] if pair[0] == source else -off[pair]
    other = NAMES[pair[1] if pair[0] == source else pair[0]]
    after = "after" if delay > 0 else "before"
    say = f"{NAMES[source].capitalize()} show the same turns {abs(delay):.2f} s {after} {other}: the clocks differ; "
    say = say.replace("gyro show", "gyro shows")
    return Fault(source, "shift", say + f"the stamps of {NAMES[source]} were moved by that.", delay)


def _delay(a: Motions, b: Motions) -> float | None:
    """Return how much later the first source shows what the second shows [s], where that is more than clocks differ."""
    start, end = max(a.stamps[0], b.stamps[0]), min(a.stamps[-1], b.stamps[-1])
    if end - start < 2.0 * _LATEST:
        return None
    t = np.arange(start, end, 1.0 / _RATE)
    x, y = (np.diff(np.interp(t, one.stamps, one.heading)) * _RATE for one in (a, b))
    if min(np.abs(x).sum(), np.abs(y).sum()) / _RATE < _TURNED:
        return None
    most = int(_LATEST * _RATE)
    alike = np.array([_correlation(x, y, shift) for shift in range(-most, most + 1)])
    best = int(np.argmax(alike))
    near = alike[most - int(_LATE * _RATE) : most + int(_LATE * _RATE) + 1]
    if -near.min() > alike[best]:
        return None  # of the other sign, which swaying turns take for half a period
    apart = 1.0 - alike[best] ** 2, 1.0 - max(alike[most], 0.0) ** 2
    if alike[best] < _ALIKE or best in (0, 2 * most) or apart[1] < _CLEARER * apart[0]:
        return None
    left, middle, right = alike[best - 1 : best + 2].tolist()
    delay = (best - most + 0.5 * (left - right) / (left - 2.0 * middle + right)) / _RATE  # the parabola's top
    return delay if abs(delay) > _LATE else None


def _correlation(x: np.ndarray, y: np.ndarray, shift: int) -> float:
    x, y = (x[shift:], y[: len(y) - shift]) if shift >= 0 else (x[:shift], y[-shift:])
    x, y = x - x.mean(), y - y.mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 0 else 0.0


_BLOCK = 100  # corrections in a row that are judged together
_HOLDS = 2.0  # of the degrees of freedom, above which a mean NIS says that the covariance does not hold


def verdict(corrections: Sequence[Correction]) -> str:
    """Return whether the estimate's covariance holds, by its own innovations: a sentence where it does not, else "".

    The mean of 100 squared innovations that are as large as stated is beyond twice its value once in 1e20; what is
    found here is no chance. Where the innovations are too small nothing is said.
    """
    worst: tuple[float, str] = (0.0, "")
    for source in sorted({one.source for one in corrections if one.dof}):
        rows = [one for one in corrections if one.source == source and one.dof and np.isfinite(one.nis)]
        nis, dof = np.array([one.nis for one in rows]), np.array([float(one.dof) for one in rows])
        if len(rows) < _BLOCK:
            continue
        starts = np.arange(0, len(rows) - _BLOCK + 1, _BLOCK)
        ratio = np.array([nis[i : i + _BLOCK].sum() / dof[i : i + _BLOCK].sum() for i in starts])
        total, bad = float(nis.sum() / dof.sum()), ratio > _HOLDS
        if total <= _HOLDS or not bad.any() or total <= worst[0]:
            continue
        at = [rows[starts[i]].stamp - corrections[0].stamp for i in np.flatnonzero(bad)]
        until = rows[min(starts[np.flatnonzero(bad)[-1]] + _BLOCK, len(rows) - 1)].stamp - corrections[0].stamp
        worst = (
            total,
            f"The covariance does not hold: the innovations of {source} are {total:.1f} times as large, squared, as it "
            f"says (NIS {nis.mean():.1f} where {dof.mean():.1f} is right), in {bad.mean():.0%} of the run, between "
            f"{at[0]:.0f} s and {until:.0f} s.",
        )
    return worst[1]
