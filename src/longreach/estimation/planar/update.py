"""One event taken: predict to its stamp (3.28), observe, gate, correct (3.29). `filter` puts events in order.

Relative poses of a source refer to its pose clone, a past pose in the state. Two kinds of source move their clones
differently:
* wheel odometry, whose readings have an error of their own: its clone is carried along from reading to reading;
* a keyframe (LIDAR): its clone stays while matches refer to it. The noise of the keyframe's own scan, which they have
  in common, is an error of the clone: it stands for the keyframe's pose as its scan shows it. A scan that becomes a
  keyframe is a clone from its own match on, so that its noise is counted once.

The local reference is the keyframe before the last: its clone becomes the reference when the next keyframe has been
added. By then all scans that were matched to it have measured where it is. (With the last keyframe itself as the
reference, the noise of its scan, which later scans observe, stays in odom; simulated drives were then up to twice as
wrong.) Where there are no keyframes, or they are far, the reference is renewed on the way: docs/estimation.md, 3.
"""

import math
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from longreach.estimation.planar import _measurement_kernels as kernels
from longreach.estimation.planar import ekf, motion_model
from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.fault_detection import bias_jumps_found, bump_found, faults_found, moving, widened
from longreach.estimation.planar.measurement_models import Measurement, Observation, PlanarImu, Relation, observe
from longreach.estimation.planar.noise_adaptation import NOMINAL, Noise, corrected, process_noise, scaled, way
from longreach.estimation.planar.state import Clone, Correction, Event, Keyframe, Link, PoseClone, Snapshot, Tally
from longreach.estimation.replay_buffer import Key
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement, RelativePoseMeasurement

_OWN = 0.05  # at least this part of a match's variance is its own
# Of the variance of a keyframe's match, the part that is the same error for the scans that are matched after it: nearly
# all, for the scan enters the local map where that match put it. The rest is how the map itself drifts from keyframe to
# keyframe; chosen so that the NEES of simulated drives is right (benchmarks/never_worse.py).
_SAME = 0.99
_FAR = 1.0  # [m], [rad] from the reference, where it is renewed
_LOST = 30.0  # [m], [rad] likewise where there is a keyframe: a laser's range, from where no scan is matched to it
_STALE = 1.5  # [s] at most that a reading is taken for the last one once more; then the base stands
_NOTHING_ADDED, _NO_MOTION = ekf.frozen(np.zeros((2, 3, 3))), ekf.frozen(np.zeros(3))
_NO_TALLY, _NO_STEPS = Tally(), np.zeros((0, 2, 3, 3))


def take(config: FilterConfig, before: Snapshot, key: Key, event: Event) -> tuple[Snapshot, Correction]:
    """Predict to the event's stamp, then clone the pose or correct by the measurement."""
    now = predicted(config, before if before.links is None else before._replace(links=()), key)
    if isinstance(event, PoseMeasurement):
        return _corrected(config, now, event)
    if isinstance(event, Keyframe):
        seen, correction, own = _keyframe_seen(config, now, event)
        return _keyframe_added(_slip_seen(config, now, seen, correction), event, own), correction
    if isinstance(event, PoseClone):
        return _cloned(now, event), Correction(event.stamp, event.source, "used")
    if not isinstance(event, RelativePoseMeasurement):
        after, correction = _corrected(config, now, event)
    elif event.reading_covariance is not None:
        if _is_stale(config, now, event):
            return _passed_over(now, event)
        now, left = _carried(config, now, event)
        after, correction = _corrected(config, now, event, left)
    else:
        now, left = _apart(now, event)
        after, correction = _corrected(config, now, event, left)
        after = _slip_seen(config, now, after, correction)
    return _renewed(after), correction


def predicted(config: FilterConfig, before: Snapshot, key: Key) -> Snapshot:
    """Predict to a time, with what the wheels slip until then. (3.28)"""
    dt = float(key[0] - before.key[0])
    if not dt > 0.0:
        return before._replace(key=key)
    mean, P = ekf.predict(config.motion, before.mean, before.P, dt)
    now = _linked(before, lambda: motion_model.transition(config.motion, before.mean, dt)[1])
    now = now._replace(key=key, mean=mean, P=P)
    return _slipped(now, before.key[0]) if now.slip.slips else now


def _rebased(now: Snapshot, i: int) -> Snapshot:
    """Make the pose at i the reference."""
    mean, P, M = ekf.rebase(now.mean, now.P, i)
    return _linked(now, lambda: M)._replace(mean=mean, P=P)


def _renewed(now: Snapshot) -> Snapshot:
    """Make the best known pose the reference, where the last one is far."""
    off = max(math.hypot(now.mean[0], now.mean[1]), abs(now.mean[2]))
    if off < _FAR or (off < _LOST and any(clone.keyframe for clone in now.clones.values())):
        return now
    return _rebased(now, _best_known(now))


def _best_known(now: Snapshot) -> int:
    """Return where in the mean the pose is that nothing to come improves: where wheels say that the base is.

    The base's own pose waits for their next reading to be corrected; it serves where there are no wheels.
    """
    return next((now.clones[wheels].at for wheels in now.steps), 0)


def _slipped(now: Snapshot, since: float) -> Snapshot:
    """Move the pose, and where wheel odometry says that it is, by what the wheels have slipped since then."""
    xi, variance = way(now.slip, math.hypot(now.mean[3], now.mean[4]), since, now.key[0])
    error, P, Q = np.zeros(len(now.mean)), now.P, variance * np.eye(3)
    error[:3] = xi
    for wheels in now.steps:
        i = now.clones[wheels].at
        error[i : i + 3] = xi
        P = widened(P, moving(now, wheels, "", 0), Q)
    return now._replace(mean=ekf.frozen(motion_model.retract(now.mean, error)), P=P)


def _slip_seen(config: FilterConfig, before: Snapshot, after: Snapshot, correction: Correction) -> Snapshot:
    """Learn how the wheels slip from how far the pose was off, and where it was moved to; not beyond the gate."""
    if config.noise_memory == 0.0 or correction.dof < 3 or correction.reason or not before.steps:
        return after
    stamp, r, coupled = correction.stamp, correction.innovation, config.wheels.coupled
    return after._replace(slip=corrected(before.slip, r, before.mean, after.mean, stamp, coupled))


def _linked(now: Snapshot, M: Callable[[], np.ndarray]) -> Snapshot:
    """Remember how errors have moved, where that is asked for."""
    return now if now.links is None else now._replace(links=(*now.links, Link(M())))


def _chosen(now: Snapshot, rows: np.ndarray) -> Snapshot:
    mean, P = ekf.chosen(now.mean, now.P, rows)
    return _linked(now, lambda: np.eye(len(now.mean))[rows])._replace(mean=mean, P=P)


def _copied(now: Snapshot, i: int) -> Snapshot:
    """Make the pose clone at i a copy of the pose."""
    return _chosen(now, ekf.copying(max(len(now.mean), i + 3), 0, i))


def _cloned(now: Snapshot, event: PoseClone) -> Snapshot:
    old = now.clones.get(event.source)
    i = len(now.mean) if old is None else old.at
    return _copied(now, i)._replace(clones={**now.clones, event.source: Clone(i, event.stamp)})


def _keyframe_seen(
    config: FilterConfig, now: Snapshot, event: Keyframe
) -> tuple[Snapshot, Correction, np.ndarray | None]:
    """Clone the pose at a keyframe's stamp; with a match, the pose as the scan shows it, which the match measures.

    The clone is the last one. Returns also which part of its covariance is the scan's own noise.
    """
    match, at, own = event.match, len(now.mean), None
    correction = Correction(event.stamp, event.source, "used")
    if match is None:
        now = _copied(_rebased(now, _best_known(now)), at)
    else:
        now, left = _apart(now, match)
        R, known = left.covariance, bool(np.all(np.isfinite(left.covariance)))
        own = R if event.noise is None else event.noise
        noise = scaled(own, now.noise.get(event.source, NOMINAL).deviations) if known else np.zeros((3, 3))
        now = _copied(now, at)
        left = left._replace(covariance=_less(R, _SAME * own)) if known else left
        now, correction = _corrected(config, now._replace(P=_added(now.P, at, _SAME * noise)), match, left, at)
        own, now = own if known else None, now._replace(P=_added(now.P, at, (1.0 - _SAME) * noise))
    return now, correction, own


def _keyframe_added(now: Snapshot, event: Keyframe, own: np.ndarray | None) -> Snapshot:
    """Let the last clone, which is the new keyframe's, take the place of the old one's, which becomes the reference."""
    old, clone = now.clones.get(event.source), Clone(len(now.mean) - 3, event.stamp, own, True)
    if old is not None:
        if event.match is not None:
            now = _rebased(now, old.at)
        last = len(now.mean) - 3
        now = _chosen(now, ekf.copying(last, last, old.at))
        clone = clone._replace(at=old.at)
    return now._replace(clones={**now.clones, event.source: clone})


def _apart(now: Snapshot, match: RelativePoseMeasurement) -> tuple[Snapshot, Relation]:
    """Make what all matches to a keyframe have in common an error of its clone; what is left is the match's own."""
    clone, left = now.clones.get(match.source), Relation(match.stamp_reference, match.pose, match.covariance)
    if match.shared_covariance is None or clone is None or clone.stamp != match.stamp_reference:
        return now, left
    own = clone.own
    if own is None:
        if not (np.all(np.isfinite(match.pose)) and np.all(np.isfinite(match.covariance))):
            return now, left
        A = se2.adjoint(match.pose)
        own, noise = ekf.frozen(A @ match.shared_covariance @ A.T), now.noise.get(match.source, NOMINAL)
        P = _added(now.P, clone.at, scaled(own, noise.deviations))
        now = now._replace(P=P, clones={**now.clones, match.source: clone._replace(own=own)})
    R = np.empty((3, 3))
    if kernels.own_part(match.covariance, match.pose, own, _OWN, R):
        left = Relation(match.stamp_reference, match.pose, ekf.frozen(R))
    return now, left


def _less(R: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Take a part off a covariance (3, 3), but leave at least 1 - _SAME of it in every direction."""
    rest = np.empty((3, 3))
    return ekf.frozen(rest if kernels.own_part(R, _NO_MOTION, part, 1.0 - _SAME, rest) else (1.0 - _SAME) * R)


def _added(P: np.ndarray, i: int, Q: np.ndarray) -> np.ndarray:
    """Add to the covariance of the three errors at i."""
    P = P.copy()
    P[i : i + 3, i : i + 3] += 0.5 * (Q + Q.T)
    return ekf.frozen(P)


def _is_stale(config: FilterConfig, now: Snapshot, step: RelativePoseMeasurement) -> bool:
    """Whether the wheels' reading is the last one once more: no step at all, at a speed that no base loses so soon.

    A logger or driver that hangs does that for a second; the next new reading has the whole way in it. It takes scans,
    and a speed beyond the base's limit of acceleration (√3 deviations) and 2 deviations of a reading.
    """
    clone, R = now.clones.get(step.source), step.reading_covariance
    if R is None or clone is None or any(step.pose.tolist()) or not any(c.keyframe for c in now.clones.values()):
        return False
    dt, speed = step.stamp - step.stamp_reference, math.hypot(now.mean[3], now.mean[4])
    braked = math.sqrt(3.0) * max(config.acceleration_deviation[:2]) * dt
    seen = speed * dt > 2.0 * math.sqrt(max(R[0, 0], R[1, 1]))
    return bool(speed > braked and seen and step.stamp - min(clone.changed, step.stamp_reference) < _STALE)


def _passed_over(now: Snapshot, step: RelativePoseMeasurement) -> tuple[Snapshot, Correction]:
    """Leave the clone where the last new reading put it, for the step that comes after this one."""
    clone = now.clones[step.source]
    clone = clone._replace(stamp=step.stamp, changed=min(clone.changed, step.stamp_reference))
    now = now._replace(clones={**now.clones, step.source: clone})
    reason = "the reading of the wheels is the last one once more"
    return _set_aside(now, Correction(step.stamp, step.source, "gated", reason))


def _carried(config: FilterConfig, now: Snapshot, step: RelativePoseMeasurement) -> tuple[Snapshot, Relation]:
    """Take a step between two readings of the wheels: the clone goes along, and stands where the wheels say we are.

    So the error of a reading stays with that reading, whereas the error of the steps adds up in the clone. Returns
    what is left to measure: that we are at the clone, as well as a reading shows. What is no such step stays as it is.
    """
    source, clone, R = step.source, now.clones.get(step.source), step.reading_covariance
    if R is None or clone is None or clone.stamp != step.stamp_reference or not math.isfinite(sum(step.pose.tolist())):
        return now, Relation(step.stamp_reference, step.pose, step.covariance)
    noise = now.noise.get(process_noise(source), NOMINAL)
    Q, A, parts = np.empty((3, 3)), np.empty((3, 3)), np.zeros((2, 3, 3))
    kernels.step_noise(step.covariance, noise.row, step.pose, Q, A, parts)
    steps = {**now.steps, source: A @ now.steps.get(source, _NOTHING_ADDED) @ A.T + parts}
    mean, P, T = ekf.carry(config.wheels, now.mean, now.P, clone.at, step.pose, Q)
    clones = {**now.clones, source: Clone(clone.at, step.stamp, clone.own, clone.keyframe)}
    now = _linked(now, lambda: T)._replace(mean=mean, P=P, clones=clones, steps=steps)
    return now, Relation(step.stamp, _NO_MOTION, R)


def _set_aside(now: Snapshot, said: Correction) -> tuple[Snapshot, Correction]:
    tally = now.tallies.get(said.source, _NO_TALLY)
    tally = tally._replace(**{said.status: getattr(tally, said.status) + 1})
    return now._replace(tallies={**now.tallies, said.source: tally}), said


def _corrected(
    config: FilterConfig, now: Snapshot, measurement: Measurement, left: Relation | None = None, at: int = 0
) -> tuple[Snapshot, Correction]:
    """Observe, gate, correct (3.29), count, and learn how noisy the source is; at: the pose observed, 0: now.

    left: of a relative pose, what is left to measure. What a fix corrects and what all else does: `ekf`; for a
    smoother, which looks back over it, each corrects all.
    """
    source, clone, fix = measurement.source, None, isinstance(measurement, PoseMeasurement)
    said = Correction(measurement.stamp, source, "refused")
    noise, tally = now.noise.get(source, NOMINAL), now.tallies.get(source, _NO_TALLY)
    if left is not None:
        clone = now.clones.get(source)
        if clone is None or clone.stamp != left.since:
            reason = f"relative to {left.since} s, where {source} has no pose clone"
            return _set_aside(now, said._replace(reason=reason))
    observation, fault = observe(now.mean, left or measurement, *((clone.at, at) if clone else ()), noise=noise)
    if fault:
        return _set_aside(now, said._replace(reason=fault))
    r, H, R, _ = observation
    k, before = len(r), now.P
    gate, inflate = config.gates[k - 1], config.gate_mode == "inflate" or tally.streak >= config.gate_patience
    gain: Literal["all", "local", "fix"] = "all" if now.links is not None else "fix" if fix else "local"
    mean, P, nis, scale, S = judged = ekf.correct(now.mean, before, r, H, R, gate, False, gain)
    if isinstance(measurement, PlanarImu):
        now = bump_found(config, now, measurement, observation, judged) if gate < nis < math.inf else now
    elif nis > gate or source in now.streaks:
        now = faults_found(config, now, measurement, observation, judged, gate, at)
    if k == 3 and clone is not None and source not in now.steps and gate < math.inf:
        now = bias_jumps_found(config, now, r[2], S[2, 2] if now.P is before else float(H[2] @ now.P @ H[2] + R[2, 2]))
    if now.P is not before or (inflate and scale == 0.0):
        mean, P, nis, scale, S = ekf.correct(now.mean, now.P, r, H, R, gate, inflate, gain)
    if nis == math.inf:
        return _set_aside(now, said._replace(reason="its innovation has no positive definite covariance"))
    noises, steps, links = now.noise, now.steps, now.links
    if config.noise_memory > 0.0 and at == 0:  # and of the wheels' steps, where another source observes the pose
        seen = steps if (fix or left is not None) and source not in steps else {}
        noises = _learned(config, now, source, seen, observation, S)
        steps = dict.fromkeys(steps, _NOTHING_ADDED) if seen else steps
    if links is not None and scale > 0.0:
        links = (*links, Link(*ekf.correction_map(now.mean, now.P, r, H, scale * R)))
    status, reason, tally = _judged(tally, nis, gate, scale)
    tallies = {**now.tallies, source: tally}
    now = now._replace(mean=mean, P=P, tallies=tallies, noise=noises, steps=steps, links=links)
    return now, Correction(measurement.stamp, source, status, reason, r, nis, k)


def _judged(tally: Tally, nis: float, gate: float, scale: float) -> tuple[Literal["used", "gated"], str, Tally]:
    used, inflated, gated, refused, streak = tally
    if scale == 1.0:
        return "used", "", Tally(used + 1, inflated, gated, refused)
    reason = f"NIS {nis:.1f} is above the gate {gate:.1f}"
    if scale == 0.0:
        return "gated", reason, Tally(used, inflated, gated + 1, refused, streak + 1)
    reason = f"{reason}: taken with its covariance times {scale:.3g}"
    return "used", reason, Tally(used + 1, inflated + 1, gated, refused, streak + 1)


def _learned(
    config: FilterConfig, now: Snapshot, source: str, steps: Mapping[str, np.ndarray], observation: Observation,
    S: np.ndarray,
) -> Mapping[str, Noise]:  # fmt: skip
    """Learn from a source's innovation about its noise, and about that of the steps, where it shows what they added."""
    (r, H, R, blocks), names = observation, [source, *map(process_noise, steps)]
    rows = np.array([now.noise.get(name, NOMINAL).row for name in names])
    added, is_wheels = np.array([*steps.values()]) if steps else _NO_STEPS, source in now.steps
    kernels.learn(S, r, H, R, blocks, config.wheels.coupled, added, config.noise_memory, is_wheels, rows)
    return {**now.noise, **dict(zip(names, map(Noise, ekf.frozen(rows)), strict=True))}
