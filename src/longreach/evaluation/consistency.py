"""Is the covariance honest? NEES and NIS against the χ² distribution that they follow when it is.

Source: Bar-Shalom, Li & Kirubarajan 2001, "Estimation with Applications to Tracking and Navigation", section 5.4.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import gammaincinv

from longreach.errors import LongreachError
from longreach.evaluation.alignment import Pairs, need_heading
from longreach.evaluation.tables import Metric, metric
from longreach.geometry import se2

# Smallest eigenvalue of a correlation matrix that is still inverted: a corridor, known to 1 mm across and to 100 m
# along, has 1e-10.
_SINGULAR = 1e-13


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """ξ = log(mean⁻¹ · truth), order x y θ in the body frame [m, m, rad], with the covariance stated for it."""

    clock: Float[np.ndarray, " n"]
    xi: Float[np.ndarray, "n 3"]
    covariance: Float[np.ndarray, "n 3 3"]


@dataclass(frozen=True, eq=False)
class Consistency:
    """Normalised squared errors over time, each with its degrees of freedom.

    The bounds are those of a mean of independent values. The NEES along one run is far from independent: there they are
    too narrow, and only the mean over many runs may be held against them. skipped: rows that could not be used.
    """

    clock: Float[np.ndarray, " n"]
    values: Float[np.ndarray, " n"]
    dof: Float[np.ndarray, " n"]
    skipped: int = 0

    @cached_property
    def mean(self) -> float:
        """The mean value; the degrees of freedom where the covariance is honest, larger where it is too small."""
        return float(np.mean(self.values)) if len(self.values) else np.nan

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """The interval that holds the mean with a probability of 95 %."""
        if len(self.values) == 0:
            return np.nan, np.nan
        return chi2_bounds(float(np.mean(self.dof)), len(self.values))

    @cached_property
    def inside(self) -> float:
        """The fraction of single values inside their own 95 % interval; 0.95 where the covariance is honest."""
        if len(self.values) == 0:
            return np.nan
        limits = {dof: chi2_bounds(dof) for dof in np.unique(self.dof).tolist()}
        low, high = np.array([limits[dof] for dof in self.dof.tolist()]).T
        return float(np.mean((self.values >= low) & (self.values <= high)))


def chi2_bounds(dof: float | int, samples: int = 1, probability: float = 0.95) -> tuple[float, float]:
    """Return the two-sided interval that holds the mean of `samples` independent χ² values with the probability."""
    if not (dof > 0 and samples > 0 and 0 < probability < 1):
        raise LongreachError(
            f"χ² bounds need positive degrees of freedom ({dof:g}) and samples ({samples}), and a probability between "
            f"0 and 1 ({probability:g})."
        )
    tail = (1 - probability) / 2
    half = 0.5 * dof * samples  # χ² with k degrees of freedom is twice a gamma variable of shape k/2
    low, high = (float(2 * gammaincinv(half, p) / samples) for p in (tail, 1 - tail))
    return low, high


def pose_errors(pairs: Pairs, relative_to_start: bool = True) -> PoseErrors:
    """Return ξ = log(mean⁻¹ · truth) of each pair.

    Arguments: relative_to_start: see both from their own first pose, as an estimate that starts anywhere with no
    uncertainty must be; False where the two share a frame.

    Raises:
        LongreachError: the estimate has no covariance, or headings are not known.
    """
    need_heading(pairs, "compare errors with their covariance")
    if pairs.covariance is None:
        raise LongreachError("The estimate has no covariance to compare its errors with.")
    estimate, truth = pairs.estimate, pairs.truth
    if relative_to_start:
        estimate, truth = se2.between(estimate[:1], estimate), se2.between(truth[:1], truth)
    return PoseErrors(pairs.clock, se2.difference(estimate, truth), pairs.covariance)


def nees(errors: PoseErrors) -> Consistency:
    """Return ξᵀ P⁻¹ ξ of each row; rows whose covariance is not finite and positive definite are skipped and counted.

    So the start is skipped, where the estimate is certain.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.sqrt(np.diagonal(errors.covariance, axis1=1, axis2=2))  # metres and radians become comparable
        z = errors.xi / scale
        R = errors.covariance / (scale[:, :, None] * scale[:, None, :])
    good = _positive_definite(R) & np.all(np.isfinite(z), axis=1)
    values = np.sum(z[good] * np.linalg.solve(R[good], z[good, :, None])[..., 0], axis=1)
    return Consistency(errors.clock[good], values, np.full(len(values), 3.0), int(np.count_nonzero(~good)))


def _positive_definite(R: Float[np.ndarray, "n 3 3"]) -> Bool[np.ndarray, " n"]:
    good = np.all(np.isfinite(R), axis=(1, 2))
    good[good] = np.linalg.eigvalsh(R[good])[:, 0] > _SINGULAR
    return good


def nis(
    clock: Float[np.ndarray, " n"], sources: Sequence[str], values: Float[np.ndarray, " n"], dof: Sequence[int]
) -> Mapping[str, Consistency]:
    """Sort normalised innovations squared by source, in the order of first appearance.

    Values that are not finite are skipped and counted; those without degrees of freedom were never compared, and are
    left out.
    """
    freedom, names = np.asarray(dof, dtype=float), np.asarray(sources, dtype=object)
    found = {}
    for source in dict.fromkeys(sources):
        compared = (names == source) & (freedom > 0)
        good = compared & np.isfinite(values)
        skipped = int(np.count_nonzero(compared & ~good))
        if np.any(compared):
            found[source] = Consistency(clock[good], values[good], freedom[good], skipped)
    return found


def consistency_metrics(name: str, consistency: Consistency) -> dict[str, Metric]:
    """Return the numbers of metrics.json for `name`, nees or nis_SOURCE."""
    low, high = consistency.bounds
    return {
        f"{name}_mean": metric(consistency.mean, ""),
        f"{name}_lower": metric(low, ""),
        f"{name}_upper": metric(high, ""),
        f"{name}_inside": metric(100 * consistency.inside, "%"),
        f"{name}_rows": metric(len(consistency.values), ""),
    }
