"""Is the filter as sure as it should be? Monte Carlo NEES on two models simulated from the filter's own assumptions.

    python benchmarks/filter_consistency.py [RUNS]

(a) linear: no rotation, wheel twists and position fixes; (b) planar: wheel twists, LIDAR poses relative to keyframes,
an IMU off the centre, a full pose now and then. The error at the end of each run, one sample a run, has mean NEES equal
to its number of components; printed with the 95 % bounds of χ². Exit code 1 when one is outside.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.special import gammaincinv

from longreach.estimation.planar import motion_model
from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.filter import FilterState, in_order, init, step
from longreach.estimation.planar.measurement_models import PlanarImu
from longreach.estimation.planar.state import Keyframe
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement, RelativePoseMeasurement, TwistMeasurement

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from true_motion import draw

DURATION = 6.0  # [s]
SEED = 7
START = np.array([1.0, -2.0, 0.0])
WHEELS = np.diag([0.03, 0.03, 0.05]) ** 2
FIX = np.diag([0.05, 0.08, 0.03]) ** 2
MATCH = np.array([[4e-4, 1e-4, 0.0], [1e-4, 3e-4, 5e-5], [0.0, 5e-5, 1e-4]])
RATE, ACCELERATION, POSITION = 0.01**2, np.diag([0.1, 0.15]) ** 2, np.array([0.21, -0.29])


def _noise(R: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.linalg.cholesky(R) @ rng.standard_normal(len(R))


def _draw_start(state: FilterState, rng: np.random.Generator) -> np.ndarray:
    error = np.zeros(13)
    P = state.belief.covariance
    measured = np.diag(P) > 0
    error[:10][measured] = _noise(P[np.ix_(measured, measured)], rng)
    mean = np.concatenate([state.belief.pose, state.newest.mean[3:13]])
    return motion_model.retract(mean, error)


def _error(state: FilterState, truth: np.ndarray) -> np.ndarray:
    return np.concatenate([se2.difference(state.belief.pose, truth[:3]), truth[3:10] - state.newest.mean[3:10]])


def _nees(error: np.ndarray, P: np.ndarray, components: list[int]) -> float:
    e = error[components]
    return float(e @ np.linalg.solve(P[np.ix_(components, components)], e))


def linear_run(rng: np.random.Generator) -> tuple[FilterState, np.ndarray]:
    """Simulate and filter (a); returns the last state and the truth."""
    still = 1e-9  # the heading neither turns nor is uncertain
    config = FilterConfig(
        acceleration_deviation=(1.0, 0.7, still),
        initial_twist_deviation=(1.0, 1.0, still),
        gate_mode="none",
        history=0.0,
    )
    state = init(0.0, START, np.diag([0.1, 0.2, still]) ** 2, config)
    truth, now = _draw_start(state, rng), 0.0
    wheels = [(t, "wheels") for t in np.arange(0.02, DURATION, 0.02)]
    for stamp, source in sorted([*wheels, *((t, "fix") for t in np.arange(0.5, DURATION, 1.0))]):
        truth, now = draw(config.motion, truth, stamp - now, rng), stamp
        if source == "wheels":
            event = TwistMeasurement(stamp, truth[3:6] + _noise(WHEELS, rng), WHEELS)
        else:
            R = FIX.copy()
            R[2, 2] = np.inf
            event = PoseMeasurement(stamp, truth[:3] + _noise(FIX, rng), R)
        state, _ = step(state, event)
    return state, truth


def planar_run(rng: np.random.Generator) -> tuple[FilterState, np.ndarray]:
    """Simulate and filter (b); returns the last state and the truth."""
    config = FilterConfig(gate_mode="none", history=0.0)
    state = init(0.0, START, np.diag([0.1, 0.1, 0.05]) ** 2, config)
    truth, now, keyframe, keyframe_stamp = _draw_start(state, rng), 0.0, START, -1.0
    plan = [(t, "wheels") for t in np.arange(0.02, DURATION, 0.02)]
    plan += [(t, "imu") for t in np.arange(0.025, DURATION, 0.02)]
    plan += [(t, "lidar") for t in np.arange(0.1, DURATION, 0.1)]
    plan += [(t, "fix") for t in np.arange(1.03, DURATION, 2.0)]
    for stamp, source in sorted(plan):
        truth, now = draw(config.motion, truth, stamp - now, rng), stamp
        x, v, (vx, vy, w), a = truth[:3], truth[3:6], truth[3:6], truth[6:9]
        events = []
        if source == "wheels":
            events = [TwistMeasurement(stamp, v + _noise(WHEELS, rng), WHEELS)]
        elif source == "imu":
            p = POSITION
            at_p = a[:2] + w * np.array([-vy, vx]) + a[2] * np.array([-p[1], p[0]]) - w * w * p
            rate = w + truth[9] + np.sqrt(RATE) * rng.standard_normal()
            events = [PlanarImu(stamp, float(rate), at_p + _noise(ACCELERATION, rng), p, RATE, ACCELERATION)]
        elif source == "fix":
            events = [PoseMeasurement(stamp, x + _noise(FIX, rng), FIX)]
        else:
            if keyframe_stamp >= 0.0:
                z = se2.retract(se2.between(keyframe, x), -_noise(MATCH, rng))
                events = [RelativePoseMeasurement(keyframe_stamp, stamp, z, MATCH, "lidar")]
            if stamp - keyframe_stamp > 0.95:
                keyframe, keyframe_stamp = x, stamp
                events.append(Keyframe(stamp, "lidar"))
        for event in in_order(events):
            state, _ = step(state, event)
    return state, truth


def mean_nees(run: Callable, components: dict[str, list[int]], runs: int, seed: int) -> dict[str, tuple[float, ...]]:
    """Return by name of the components: mean NEES over the runs, lower and upper 95 % bound."""
    values = {name: [] for name in components}
    for rng in np.random.default_rng(seed).spawn(runs):
        state, truth = run(rng)
        error, P = _error(state, truth), state.belief.covariance
        for name, which in components.items():
            values[name].append(_nees(error, P, which))
    bounds = {n: [2.0 * gammaincinv(0.5 * runs * n, p) / runs for p in (0.025, 0.975)] for n in range(1, 11)}
    return {name: (float(np.mean(v)), *bounds[len(components[name])]) for name, v in values.items()}


MODELS = {
    "linear": (linear_run, {"position": [0, 1], "position, velocity, acceleration": [0, 1, 3, 4, 6, 7]}),
    "planar": (planar_run, {"pose": [0, 1, 2], "whole state": list(range(10))}),
}


def main() -> int:
    """Print the table; 0 when all are inside their bounds."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    outside = 0
    for model, (run, components) in MODELS.items():
        for name, (nees, lower, upper) in mean_nees(run, components, runs, SEED).items():
            inside = lower <= nees <= upper
            outside += not inside
            verdict = "inside" if inside else "OUTSIDE"
            print(f"{model:7} {name:33} mean NEES {nees:6.3f} over {runs} runs, ", end="")
            print(f"95 % bounds {lower:6.3f} to {upper:6.3f}: {verdict}")
    return 1 if outside else 0


if __name__ == "__main__":
    sys.exit(main())
