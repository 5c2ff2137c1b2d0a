"""What a run shows: the rank of the motions' information, a deviation of each parameter, and what it cannot show.

A direction of the parameters is shown where its deviation is within `limits`. A parameter that has a part in any other
direction is not observable: it is refused by name, with the manoeuvre that would show it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from longreach.calibration.extrinsics import MOUNT, SCALE_DEVIATION, Fit, fit, limits, start
from longreach.calibration.wheels import Motions, WheelModel
from longreach.errors import CalibrationError

_PART = 0.02  # of a parameter's square that may lie in directions that are not shown; ours
_STRAIGHT, _TURN = "drive straight for 2 m, forwards and back", "turn on the spot for 20 s"
_SIDEWAYS = "drive sideways for 2 m, and back"


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What motions show of wheels and sensor: each parameter by its name, in the order of `values`.

    nominal (q,): before. covariance (q, q): zero in rows of what is not observable, which keeps its nominal value.
    rank: directions of the parameters that the motions show. fit: of all parameters together, where those that are not
    observable took any value that explains the motions; the others do not depend on it.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: Float[np.ndarray, " q"]
    values: Float[np.ndarray, " q"]
    covariance: Float[np.ndarray, "q q"]
    observable: Bool[np.ndarray, " q"]
    rank: int
    fit: Fit


def calibrate_motions(
    model: WheelModel,
    motions: Motions,
    mount: Float[np.ndarray, "3"] | None = None,
    scale_deviation: float = SCALE_DEVIATION,
) -> Calibrated:
    """Return wheels and mount of a sensor as far as motions show them; what they do not show keeps its nominal value.

    mount (3,): nominal pose of the sensor [m, m, rad]. scale_deviation [1]: of the sensor's lengths, which all share.

    Raises CalibrationError where nothing is observable, or wheels and sensor contradict each other.
    """
    mount = np.zeros(3) if mount is None else mount
    nominal, names = np.concatenate((model.nominal, mount)), (*model.names, *MOUNT)
    found = fit(model, motions, start(model, motions))
    covariance, observable, rank = _shown(model, found, scale_deviation)
    if not observable.any():
        ways = dict.fromkeys(manoeuvre(name) for name in names)
        raise CalibrationError(f"No parameter is observable from this run by itself: {'; then '.join(ways)}.")
    values = np.where(observable, found.values, nominal)
    covariance = np.where(np.outer(observable, observable), covariance, 0.0)
    return Calibrated(names, (*model.units, "m", "m", "rad"), nominal, values, covariance, observable, rank, found)


def _shown(model: WheelModel, found: Fit, scale_deviation: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the covariance (q, q), what is observable (q,), and in how many directions."""
    D, H, prior = limits(model), found.information, found.prior
    q = len(D)
    slip = np.linalg.solve(H[q:, q:] + prior[q:, q:], H[q:, :q])  # what motions say of slip, they do not say of q
    values, V = np.linalg.eigh(D[:, None] * (H[:q, :q] - H[:q, q:] @ slip) * D)
    good = values > 1.0
    seen = np.eye(len(H))[:, q - good.sum() :]
    seen[:q, : good.sum()] = D[:, None] * V[:, good]
    inverse = seen @ np.linalg.inv(seen.T @ (H + prior) @ seen) @ seen.T
    kinds = zip((*model.names, *MOUNT), (*model.units, "m", "m", "rad"), strict=True)
    lengths = np.array([kind == "m" or name in ("scale_x", "scale_y") for name, kind in kinds])
    common = np.where(lengths, scale_deviation * found.values, 0.0)
    covariance = (inverse @ (found.scatter + prior) @ inverse)[:q, :q] + np.outer(common, common)
    inside = (V[:, good] ** 2).sum(axis=1)
    observable = (inside > 1.0 - _PART) & (np.sqrt(np.diag(covariance)) < D)
    observable[-3:-1] = observable[-3:-1].all()  # a turn of the sensor about the base's centre changes x or y, or both
    return covariance, observable, int(good.sum())


def manoeuvre(name: str) -> str:
    """Return the driving that shows a parameter best."""
    if name.startswith("scale"):
        return {"scale_x": _STRAIGHT, "scale_y": _SIDEWAYS}.get(name, _TURN)
    return _TURN if name in ("k", "track_width") or name.endswith(("_x", "_y")) else _STRAIGHT


def not_shown(name: str) -> str:
    """Return the sentence that refuses a parameter by name."""
    return f"{name} is not observable from this run: {manoeuvre(name)}."
