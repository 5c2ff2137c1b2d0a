"""Who is wrong, where a measurement is beyond what was believed: the source, the wheels' steps, or the belief."""

import math
from collections.abc import Mapping

import numpy as np

from longreach.estimation import _cholesky_kernels, ekf
from longreach.estimation.filter_config import FilterConfig
from longreach.estimation.noise import AS_STATED, steps_of, worse
from longreach.estimation.observation import Measurement, Observation
from longreach.estimation.snapshot import Doubt, Snapshot
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement, RelativePoseMeasurement

_USUAL, _TOO_MUCH = 1.0, 8.0  # taken off the sum of headings' innovations each time; its bound, 1e-7 by chance
_STEP = 2.5  # of the deviation that a gyro's bias has when switched on, that it may jump by
_LASTING = 10.0  # of _SLIPS, at most, that goes on: more is a bump, or a match that is wrong
_SLIPS = (1.0, 3.0, 10.0, 30.0, 100.0)  # of the variance of the steps since another source told the pose


def blamed(
    config: FilterConfig,
    now: Snapshot,
    measurement: Measurement,
    observation: Observation,
    S: np.ndarray,
    gate: float,
    at: int,
) -> Snapshot:
    """Where an innovation is beyond the gate, say what may be wrong with what was believed, before the source is.

    First the steps of counters: wheels slip, by ten times what their steps are usually wrong by. Where that does not
    do, and a source says again and again that the pose is off by the same, it has been moved: then the source is right.
    S (k, k): of the innovation.
    """
    (r, H, _), source = observation, measurement.source
    if not (
        isinstance(measurement, PoseMeasurement | RelativePoseMeasurement)
        and _cholesky_kernels.squared_norm(S, r) > gate
    ):
        return now._replace(doubts=_without(now.doubts, source)) if source in now.doubts else now
    if source in now.steps and now.tallies.keys() <= now.steps.keys():
        return now  # nobody else can tell
    doubts = _without(now.doubts, source)
    for counter, added in now.steps.items():
        M, Q = moving(now, counter, source, at), np.sum(added, axis=0)
        HM = H @ M
        for s in _SLIPS:
            if _cholesky_kernels.squared_norm(S + s * HM @ Q @ HM.T, r) <= gate:
                loose = now._replace(P=loosened(now.P, M, s * Q), doubts=doubts)
                return loose if source == counter else _slipped(config, loose, counter, s)
    if source in now.steps:
        return now
    xi, before = np.linalg.lstsq(H[:, at : at + 3], r, rcond=None)[0], now.doubts.get(source)
    same = before is not None and np.linalg.norm(xi - before.xi) < 0.5 * np.linalg.norm(xi)
    times = before.times + 1 if before is not None and same else 1
    if times <= config.gate_patience:
        return now._replace(doubts={**doubts, source: Doubt(times, xi)})
    P = now.P
    for counter in now.steps or ("",):
        P = loosened(P, moving(now, counter, source, at), np.outer(xi, xi))
    return now._replace(P=P, doubts=doubts)


def _slipped(config: FilterConfig, now: Snapshot, counter: str, s: float) -> Snapshot:
    """Let steps to come be as noisy as those that slipped, until innovations tell otherwise; a bump does not last."""
    if config.noise_memory == 0.0 or s > _LASTING:
        return now
    name, led = steps_of(counter), config.counter.led
    noise = worse(now.noise.get(name, AS_STATED), 1.0 + s * led[1:])
    return now._replace(noise={**now.noise, name: noise})


def moving(now: Snapshot, counter: str, source: str, at: int) -> np.ndarray:
    """Return how an error of the pose (3,), which a counter has made, is in the whole state (n, 3).

    Where the counter's own reading tells, the error is its anchor's alone.
    """
    M, eye = np.zeros((len(now.mean), 3)), np.eye(3)
    if counter != source:
        M[:3] = M[at : at + 3] = eye
    if counter in now.anchors:
        i = ekf.BODY + 3 * now.anchors[counter].number
        M[i : i + 3] = se2.adjoint(se2.between(now.mean[i : i + 3], now.mean[:3]))
    return M


def loosened(P: np.ndarray, M: np.ndarray, Q: np.ndarray) -> np.ndarray:
    P = P + M @ Q @ M.T
    P = 0.5 * (P + P.T)
    P.flags.writeable = False
    return P


def _without(doubts: Mapping[str, Doubt], source: str) -> dict[str, Doubt]:
    return {name: doubt for name, doubt in doubts.items() if name != source}


def drifting(config: FilterConfig, now: Snapshot, innovation: float, variance: float) -> Snapshot:
    """Where headings are off to one side again and again, let the gyro's bias have jumped.

    innovation [rad]: of a heading, N(0, variance) and white where the filter is right. Their cumulative sum tells a
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
    P.flags.writeable = False
    return now._replace(P=P, drift=0.0)
