"""Wheels and the planar pose of a sensor, by maximum likelihood over motions between keyframes.

A sensor at the pose l on a base that moves by o(p) is displaced by s = l⁻¹ · o(p) · l. Wheels and l are what makes
e = log(s⁻¹ · measured) most likely, under noise of a size that the residuals themselves show, with heavy tails
(Student's t, which weighs a motion by (ν + d) / (ν + eᵀ Σ⁻¹ e)). A motion beyond the gate slipped, and takes no part.

**Start.** In closed form, as Censi et al.: heading is linear in the wheels' turns; then
R(l_θ) s_xy = (R(o_θ) - I) l_xy + scale · o_xy is linear in scale, l_x, l_y, cos l_θ and sin l_θ, of which the last two
have the length 1, so that they are an eigenvector.

**Covariance.** H⁻¹ S H⁻¹: H is the information of the law, S the scatter of the motions' own contributions, with what
correlation of neighbours adds to it (Newey & West 1987). What all motions
share adds to it: lengths are only as good as the sensor's own scale.

Source: Censi, Franchi, Marchionni & Oriolo 2013, "Simultaneous calibration of odometry and sensor parameters for mobile
robots". There noise is Gaussian, of given size, and a share of the worst motions is left out; Lange, Little & Taylor
1989 for Student's t with ν = 4.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import f as f_law

from longreach.calibration.wheels import Motions, WheelModel, adjoints, base_motion
from longreach.errors import CalibrationError
from longreach.geometry import se2

MOUNT = ("laser_x", "laser_y", "laser_yaw")
SCALE_DEVIATION = 0.005  # of a laser's lengths: data sheets state 1 % of the range (Hokuyo URG-04LX)
_NU = 4.0  # degrees of freedom of the noise's law; Lange et al. 1989
_FALSE_ALARM = 1e-3  # share of good motions that the gate leaves out, under that law
_ITERATIONS, _CHANGE = 60, 1e-7  # at most, and the change in units of `limits` that ends them
_FLOOR = 1e-5  # of the noise [m, rad], which keeps the information of exact motions well conditioned
_LEAST_TURN = 0.01  # [rad] of a motion, at which the closed form begins to see where the sensor is
# Wheels of one make differ by what a maker allows: ISO 2768-1, medium, by diameter up to [m], ± [m].
_SIZES, _TOLERANCES = (0.006, 0.03, 0.12, 0.4, 1.0), (0.0001, 0.0002, 0.0003, 0.0005, 0.0008, 0.0012)
_MOVED = 1e-3  # [m, rad]: less is standing
_FEWEST = 20  # motions that a calibration takes


@dataclass(frozen=True, eq=False)
class Fit:
    """What motions show of a model's parameters q = (wheels, sensor) (q,), and of the slip (s,) of its wheels.

    information (q + s, q + s): of all, whether they are observable or not. prior (q + s, q + s): of the radii's ratios
    and of slip. scatter (q + s, q + s): S.
    residual (n, d): white e, and the wheels' disagreement. noise (d, d): Σ of a motion, in units of its own covariance
    where it has one. used (n,): whether it passed the gate.
    """

    values: Float[np.ndarray, " q"]
    slip: Float[np.ndarray, " s"]
    information: Float[np.ndarray, "k k"]
    prior: Float[np.ndarray, "k k"]
    scatter: Float[np.ndarray, "k k"]
    residual: Float[np.ndarray, "n d"]
    noise: Float[np.ndarray, "d d"]
    used: Bool[np.ndarray, " n"]


def sensor_displacement(
    model: WheelModel, q: Float[np.ndarray, " q"], motions: Motions
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 q"]]:
    """Return each displacement s of the sensor (n, 3) and its derivative (n, 3, q) in the sensor's frame at the end.

    q may go on with the model's slip (s,); so does the derivative.
    """
    n = len(model.nominal)
    p, l = np.concatenate((q[:n], q[n + 3 :])), q[n : n + 3]
    o, by_wheels = base_motion(model, p, motions)
    s = se2.compose(se2.compose(se2.inverse(l), o), l)
    cosine, sine = np.cos(l[2]), np.sin(l[2])
    turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    by_mount = turned - adjoints(se2.inverse(s)) @ turned
    by_wheels = se2.adjoint(se2.inverse(l)) @ by_wheels
    return s, np.concatenate((by_wheels[..., :n], by_mount, by_wheels[..., n:]), axis=2)


def start(model: WheelModel, motions: Motions) -> Float[np.ndarray, " q"]:
    """Return wheels and mount in closed form: of a differential base all of them, else with wheels of nominal ratios.

    Raises CalibrationError where wheels and sensor turn opposite ways.
    """
    p, turned = model.nominal.copy(), motions.displacement[:, 2]
    by_wheel = model.matrix(p)[0][2] * _turns(motions)
    by_wheel = by_wheel if model.names[-1] == "track_width" else by_wheel.sum(axis=1, keepdims=True)
    if np.ptp(turned) > 0.1 and np.linalg.matrix_rank(by_wheel, tol=0.1) == by_wheel.shape[1]:
        rate, _ = _robust_linear(by_wheel, turned)  # of the nominal heading, a wheel each or all together
        if np.all(rate < 0.0):
            raise CalibrationError(
                "The wheels turn the base the other way than the sensor sees: exchange the left and the right wheels "
                "in base.wheel_names, or say that the sensor is upside down (lidar.mount.roll: 3.14159)."
            )
        if len(rate) == 2 and np.all(rate > 0.2):
            p[:2] *= rate
        elif len(rate) == 1 and model.names[-1] == "k" and rate[0] > 0.2:
            p[-1] /= rate[0]
    scale, mount = _mount_and_scale(base_motion(model, p, motions)[0], motions.displacement)
    lengths = np.array(model.units) == "m"
    if 0.2 < scale < 5.0:
        p[lengths] *= scale
    return np.concatenate((p, mount))


def _turns(motions: Motions) -> np.ndarray:
    """Return the turns (n, w) of the wheels in each motion."""
    total = np.concatenate((np.zeros((1, motions.turns.shape[1])), np.cumsum(motions.turns, axis=0)))
    return total[motions.spans[:, 1]] - total[motions.spans[:, 0]]


def _robust_linear(A: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x (k,) with A x = y, and Cauchy weights (n,) of the rows by the mean residual."""
    w, x = np.ones(len(y)), np.zeros(A.shape[1])
    for _ in range(20):
        x = np.linalg.lstsq(A * np.sqrt(w)[:, None], y * np.sqrt(w), rcond=1e-8)[0]
        r = A @ x - y
        w = 1.0 / (1.0 + (r / max(float(np.mean(np.abs(r))), 1e-9)) ** 2)
    return x, w


def _mount_and_scale(o: Float[np.ndarray, "n 3"], s: Float[np.ndarray, "n 3"]) -> tuple[float, np.ndarray]:
    """Return the scale of the base's displacements o, and the mount (3,), that explain those of the sensor."""
    c, n = np.cos(o[:, 2]) - 1.0, np.sin(o[:, 2])
    A = np.array([[o[:, 0], c, -n], [o[:, 1], n, c]]).transpose(2, 0, 1)  # (n, 2, 3) · (scale, l_x, l_y)
    B = np.array([[s[:, 0], -s[:, 1]], [s[:, 1], s[:, 0]]]).transpose(2, 0, 1)  # (n, 2, 2) · (cos, sin)
    w, scale, mount = np.ones(len(o)), 1.0, np.zeros(3)
    ridge = np.diag([0.0, 1.0, 1.0]) * len(o) * _LEAST_TURN**2  # keeps l_x and l_y where nothing turns
    for _ in range(10):
        AA, AB, BB = (np.einsum("n,nij,nik->jk", w, X, Y) for X, Y in ((A, A), (A, B), (B, B)))
        inverse = np.linalg.pinv(AA + ridge, rcond=1e-9, hermitian=True)
        direction = np.linalg.eigh(BB - AB.T @ inverse @ AB)[1][:, 0]  # the least eigenvalue
        x = inverse @ AB @ direction
        if x[0] < 0.0:
            x, direction = -x, -direction
        scale, mount = float(x[0]), np.array([x[1], x[2], np.arctan2(direction[1], direction[0])])
        r = np.linalg.norm(A @ x - B @ direction, axis=1)
        w = 1.0 / (1.0 + (r / max(float(np.mean(r)), 1e-9)) ** 2)
    return scale, mount


def limits(model: WheelModel) -> Float[np.ndarray, " q"]:
    """Return the deviation of each parameter beyond which a run does not show it: 5 % or 5 cm, 0.05 rad; ours."""
    return np.concatenate((0.05 * model.nominal, [0.05, 0.05, 0.05]))


def fit(model: WheelModel, motions: Motions, q: Float[np.ndarray, " q"]) -> Fit:
    """Return the most likely parameters from a start q (q,) on.

    Only what the motions show is changed: directions in which all `limits` are passed stay where they start.

    Raises CalibrationError where there are too few motions, or wheels and sensor contradict each other in most.
    """
    if len(motions.spans) < _FEWEST:
        raise CalibrationError(
            f"There are {len(motions.spans)} motions between keyframes, and a calibration takes {_FEWEST} at least; "
            "drive for a minute, with turns and straight parts."
        )
    unit, whiten, prior = (
        np.concatenate((limits(model), model.slip_deviation)),
        _whitening(model, motions),
        _prior(model),
    )
    nominal, size = np.concatenate((model.nominal, np.zeros(3 + len(model.slip)))), len(q)
    q = np.concatenate((q, np.zeros(len(model.slip))))
    residual, J = _residuals(model, q, motions, whiten)
    d = residual.shape[1]
    noise = np.diag(np.mean(residual**2, axis=0) + _FLOOR**2)  # too large: what differs is not yet slip
    gate = d * float(f_law.isf(_FALSE_ALARM, d, _NU))
    W, used, weight = np.linalg.inv(noise), np.ones(len(residual), dtype=bool), np.ones(len(residual))
    for _ in range(_ITERATIONS):
        W = np.linalg.inv(noise)
        square = np.einsum("ni,ij,nj->n", residual, W, residual)
        used = square < gate
        weight = np.where(used, (_NU + d) / (_NU + square), 0.0)
        H = np.einsum("n,nij,ik,nkl->jl", weight, J, W, J)
        g = np.einsum("n,nij,ik,nk->j", weight, J, W, residual)
        change = _solved(H + prior, g - prior @ (q - nominal), unit)
        q = q + change
        residual, J = _residuals(model, q, motions, whiten)
        noise = np.einsum("n,ni,nj->ij", weight, residual, residual) / max(used.sum(), 1) + _FLOOR**2 * np.eye(d)
        if np.max(np.abs(change / unit)) < _CHANGE:
            break
    s, _ = sensor_displacement(model, q, motions)
    moved = np.median(np.linalg.norm(s, axis=1))
    off = np.median(np.linalg.norm(se2.difference(s, motions.displacement), axis=1))
    if moved > _MOVED and off > 0.5 * moved:
        raise CalibrationError(
            f"Wheels and sensor do not agree: of a motion of {moved:.2g} m or rad, half of them are off by more than "
            f"{off:.2g}; the wheels slip throughout, or their clock or order is another than the description says."
        )
    scores = np.einsum("n,nij,ik,nk->nj", weight, J, W, residual)
    H = np.einsum("n,nij,ik,nkl->jl", used * (_NU + d) / (_NU + d + 2.0), J, W, J)
    return Fit(q[:size], q[size:], H, prior, _long_run(scores), residual, noise, used)


def _prior(model: WheelModel) -> np.ndarray:
    """Return the information (q + s, q + s) of: wheels of one make differ little from each other, and slip little."""
    radii = np.array([name.startswith("radius") for name in (*model.names, *MOUNT)] + [False] * len(model.slip))
    information = np.diag(np.concatenate((np.zeros(len(model.names) + 3), model.slip_deviation**-2.0)))
    if radii.any():
        n, radius = radii.sum(), model.nominal[radii[: len(model.names)]].mean()
        sigma = 0.5 * _TOLERANCES[int(np.searchsorted(_SIZES, 2.0 * radius))]  # the limit, as one deviation: they wear
        information[np.ix_(radii, radii)] = (np.eye(n) - 1.0 / n) / sigma**2
    return information


def _solved(H: np.ndarray, g: np.ndarray, D: np.ndarray) -> np.ndarray:
    """Solve H x = g in the directions that H shows within D."""
    values, V = np.linalg.eigh(D[:, None] * H * D)
    shown = values > 1.0
    return D * (V[:, shown] @ ((V[:, shown].T @ (D * g)) / values[shown]))


def _whitening(model: WheelModel, motions: Motions) -> np.ndarray:
    """Return (n, d, d) that makes errors of all motions alike: by their covariance, and of wheels by the way."""
    n, rows = len(motions.spans), len(model.signs)
    whiten = np.tile(np.eye(3 + rows), (n, 1, 1))
    if motions.covariance is None:  # of the numbers as they are, in the axes of the start
        c, s = np.cos(motions.displacement[:, 2]), np.sin(motions.displacement[:, 2])
        whiten[:, 0, 0], whiten[:, 0, 1], whiten[:, 1, 0], whiten[:, 1, 1] = c, -s, s, c
    else:
        whiten[:, :3, :3] = np.linalg.inv(np.linalg.cholesky(motions.covariance))
    if rows:
        way = np.abs(_turns(motions)) @ np.abs(model.signs.T * model.nominal[: model.signs.shape[1], None])
        whiten[:, 3:, 3:] = (1.0 / np.sqrt(way + 0.01))[:, :, None]
    return whiten


def _residuals(model: WheelModel, q: np.ndarray, motions: Motions, whiten: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return white residuals (n, d), and minus their derivative (n, d, q)."""
    s, J = sensor_displacement(model, q, motions)
    e = se2.difference(s, motions.displacement)
    if len(model.signs):
        w = model.signs.shape[1]
        slip = np.zeros((len(s), len(model.signs), len(q)))
        turns = _turns(motions)
        slip[:, :, :w] = turns[:, None, :] * model.signs
        slip[:, :, len(q) - len(model.slip) :] = np.einsum("scw,nw->ncs", model.slip[:, 3:], turns)
        e = np.concatenate((e, -slip @ q), axis=1)
        J = np.concatenate((J, slip), axis=1)
    return np.einsum("nij,nj->ni", whiten, e), whiten @ J


def _long_run(scores: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "q q"]:
    """Return the covariance of the sum of scores that are correlated with their neighbours (Newey & West 1987).

    Only where that adds to independent ones: that errors of neighbours cancel is not relied on, since two runs of the
    same robot differ by more than is left then.
    """
    n = len(scores)
    S, neighbours, lags = scores.T @ scores, np.zeros((scores.shape[1],) * 2), int(4.0 * (n / 100.0) ** (2.0 / 9.0))
    for lag in range(1, lags + 1):
        shared = scores[lag:].T @ scores[:-lag]
        neighbours += (1.0 - lag / (lags + 1.0)) * (shared + shared.T)
    unit = np.sqrt(np.diag(S)) + 1e-150
    values, V = np.linalg.eigh(neighbours / np.outer(unit, unit))
    return S + np.outer(unit, unit) * ((V * np.maximum(values, 0.0)) @ V.T)
