"""What may be wrong where an innovation is beyond the gate: the source, the wheels' steps, or what was believed.

The gate lets 1 - `gate_probability` of good measurements through to these tests, one in 10 000; that is the false alarm
rate of the test for wheel slip, which costs a covariance that is too large until the next match. A base that was moved
takes 6 in a row that agree: by chance, at 10⁻⁴ each, never. The test for a jump of the gyro's bias has an average run
length of 2 · 10⁷ headings without one (Siegmund 1985, "Sequential analysis", for Page's test with the values below);
a false alarm forgets the bias.
"""

import math
from collections.abc import Mapping

import numpy as np

from longreach.estimation.planar import _ekf_kernels as kernels
from longreach.estimation.planar import ekf
from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.measurement_models import Measurement, Observation, PlanarImu
from longreach.estimation.planar.noise_adaptation import NOMINAL, inflated, process_noise
from longreach.estimation.planar.state import Snapshot, Streak
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement, RelativePoseMeasurement

_USUAL, _TOO_MUCH = 1.0, 8.0  # taken off the sum of headings' innovations each time, and its bound
_STEP = 2.5  # of the deviation that a gyro's bias has when switched on, that it may jump by
_LASTING = 10.0  # of _SLIPS, at most, that goes on: more is a bump, or a match that is wrong
# [m², m², rad²]: 5 mm, 0.5°. Wheels also stand still while the base moves. With the largest of _SLIPS it is 16 cm, 16°:
# more, and a burst of wrong matches would carry the estimate off.
_SMALLEST = np.diag([2.5e-5, 2.5e-5, 7.5e-5])
_BUMP = 0.5  # [s] that a bump lasts
_EYE = np.eye(3)
# Of that and the variance of the steps since another source observed the pose:
_SLIPS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)


def faults_found(
    config: FilterConfig, now: Snapshot, measurement: Measurement, observation: Observation, judged: ekf.Corrected,
    gate: float, at: int,
) -> Snapshot:  # fmt: skip
    """Where an innovation is beyond the gate, widen what may be wrong with what was believed, before the source is.

    First the steps of the wheels, as slip. Where that does not suffice, and a source says again and again that the pose
    is off by the same, then the source is right: against a fix the reference is wrong, else the base has been moved, or
    the source is wrong in a way that lasts. Nothing distinguishes these, so the reference may be off by as much.
    """
    (r, H, _, _), S, source = observation, judged.S, measurement.source
    if not (isinstance(measurement, PoseMeasurement | RelativePoseMeasurement) and gate < judged.nis < math.inf):
        return now._replace(streaks=_without(now.streaks, source)) if source in now.streaks else now
    if source in now.steps and now.tallies.keys() <= now.steps.keys():
        return now  # nobody else can tell
    fix, streaks = isinstance(measurement, PoseMeasurement), _without(now.streaks, source)
    for wheels, added in now.steps.items():
        M, Q = moving(now, wheels, source, at), np.sum(added, axis=0) + _SMALLEST
        HM = H @ M
        for s in _SLIPS:
            if kernels.squared_norm(S + s * HM @ Q @ HM.T, r) <= gate:
                wide = now._replace(P=widened(now.P, M, s * Q), streaks=streaks)
                return wide if source == wheels else _slipped(config, wide, wheels, s)
    if source in now.steps:
        return now
    i = ekf.REFERENCE if fix else at
    xi, before = np.linalg.lstsq(H[:, i : i + 3], r, rcond=None)[0], now.streaks.get(source)
    same = before is not None and np.linalg.norm(xi - before.xi) < 0.5 * np.linalg.norm(xi)
    times = before.times + 1 if before is not None and same else 1
    if times <= config.gate_patience:
        return now._replace(streaks={**streaks, source: Streak(times, xi)})
    G = np.zeros((len(now.mean), 3))
    G[ekf.REFERENCE : ekf.CLONES] = np.eye(3) if fix else se2.adjoint(now.mean[:3])
    P = widened(now.P, G, np.outer(xi, xi))
    for wheels in () if fix else now.steps or ("",):
        P = widened(P, moving(now, wheels, source, at), np.outer(xi, xi))
    return now._replace(P=P, streaks=streaks)


def bump_found(
    config: FilterConfig, now: Snapshot, measurement: PlanarImu, observation: Observation, judged: ekf.Corrected
) -> Snapshot:
    """Where gyro and accelerometer are beyond their gates at once, let the base turn at any rate: it has been bumped.

    A gyro that errs is not felt by the accelerometer. For a while after that the gyro is believed alone.
    """
    (r, _, _, _), S, source = observation, judged.S, measurement.source
    before = now.streaks.get(source)
    if len(r) == 3 and kernels.squared_norm(S[1:, 1:], r[1:]) > config.gates[1]:
        before = Streak(1, np.array([measurement.stamp, 0.0, 0.0]))
        now = now._replace(streaks={**now.streaks, source: before})
    if before is None or measurement.stamp - before.xi[0] > _BUMP or not r[0] * r[0] > config.gates[0] * S[0, 0]:
        return now
    P = now.P.copy()
    P[5, 5] += r[0] * r[0]
    return now._replace(P=ekf.frozen(P))


def _slipped(config: FilterConfig, now: Snapshot, wheels: str, s: float) -> Snapshot:
    """Let steps to come be as noisy as those that slipped, until innovations show otherwise; a bump does not last."""
    if config.noise_memory == 0.0 or s > _LASTING:
        return now
    name, coupled = process_noise(wheels), config.wheels.coupled
    noise = inflated(now.noise.get(name, NOMINAL), 1.0 + s * coupled[1:])
    return now._replace(noise={**now.noise, name: noise})


def moving(now: Snapshot, wheels: str, source: str, at: int) -> np.ndarray:
    """Return how an error of the pose (3,), which wheel odometry has made, is in the whole state (n, 3).

    Where the wheels' own reading shows it, the error is their clone's alone.
    """
    M = np.zeros((len(now.mean), 3))
    if wheels != source:
        M[:3] = M[at : at + 3] = _EYE
    if wheels in now.clones:
        i = now.clones[wheels].at
        kernels.as_clone(now.mean, i, M[i : i + 3])
    return M


def widened(P: np.ndarray, M: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Return P + M Q Mᵀ."""
    P = P + M @ Q @ M.T
    return ekf.frozen(0.5 * (P + P.T))


def _without(streaks: Mapping[str, Streak], source: str) -> dict[str, Streak]:
    return {name: streak for name, streak in streaks.items() if name != source}


def bias_jumps_found(config: FilterConfig, now: Snapshot, innovation: float, variance: float) -> Snapshot:
    """Where headings are off to one side again and again, let the gyro's bias have jumped.

    innovation [rad]: of a heading, N(0, variance) and white where the filter is right. Their cumulative sum detects a
    jump as soon as can be (Page 1954).
    """
    if not variance > 0.0:
        return now
    drift = now.drift + max(-4.0, min(4.0, float(innovation) / math.sqrt(variance)))
    drift = math.copysign(max(abs(drift) - _USUAL, 0.0), drift)
    if abs(drift) < _TOO_MUCH:
        return now._replace(drift=drift)
    P = now.P.copy()
    P[9, 9] += (_STEP * config.initial_gyro_bias_deviation) ** 2
    return now._replace(P=ekf.frozen(P), drift=0.0)
