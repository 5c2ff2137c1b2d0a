"""A drive seen by scans that err as the filter believes: what tests of keyframes and of the smoother share."""

import jaxtyping
import numpy as np
from true_motion import draw

from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.state import Keyframe
from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement, TwistMeasurement

CONFIG = FilterConfig(gate_mode="none", history=0.0)
SCAN = np.array([[4e-5, 1e-5, 0.0], [1e-5, 3e-5, 5e-6], [0.0, 5e-6, 1e-5]])  # how wrong one scan shows its pose
SAME = 0.99  # of which this part is one error where the scan is matched and where others are matched against it
WHEELS = np.diag([0.03, 0.03, 0.03]) ** 2
SCANS, EVERY = 24, 8  # in a run; scans to a keyframe


def unchecked(run, *arguments, **options):
    """Call a function with the shape checks off: over many runs they take longer than what they check."""
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        return run(*arguments, **options)
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)


def noise(rng, R=SCAN):
    return np.linalg.cholesky(R) @ rng.standard_normal(len(R))


def events_of(rng, shares=True, scans=SCANS, every=EVERY):
    """Scans at 10 Hz against keyframes: events, the last true state, and the true pose at each scan from the first.

    shares: what matches have in common is said, and a keyframe's clone has its match.
    """
    x, events, truth = np.zeros(13), [], [np.zeros(3)]
    x[3:6], x[6:9] = rng.normal(size=3), rng.normal(size=3) * CONFIG.acceleration_deviation
    keyframe, since = se2.retract(x[:3], noise(rng)), 0.0
    events.append(Keyframe(0.0, "lidar"))
    for i in range(1, scans + 1):
        x, now = draw(CONFIG.motion, x, 0.1, rng), 0.1 * i
        truth.append(x[:3])
        common = noise(rng, SAME * SCAN)
        z = se2.between(keyframe, se2.retract(x[:3], common + noise(rng, (1.0 - SAME) * SCAN)))
        A = se2.adjoint(se2.inverse(z))
        shared = A @ SCAN @ A.T
        match = RelativePoseMeasurement(since, now, z, SCAN + shared, "lidar", None, shared if shares else None)
        events.append(TwistMeasurement(now, x[3:6] + noise(rng, WHEELS), WHEELS, "wheels"))
        if i % every == 0:
            events += [Keyframe(now, "lidar", match)] if shares else [match, Keyframe(now, "lidar")]
            keyframe, since = se2.retract(x[:3], common + noise(rng, (1.0 - SAME) * SCAN)), now
        else:
            events.append(match)
    return events, x, truth
