"""How noisy each source really is: factors on its covariance, estimated from the innovations while the filter runs.

A covariance R that is stated is taken as D R D with D² = diag of two factors, one for translations and one for turns.
Their logarithms follow the likelihood of the innovations, r ~ N(0, H P Hᵀ + D R D), by steps of the score over the
information gathered (stochastic approximation: Robbins & Monro 1951; Titterington 1984), which is forgotten over
`noise_memory` measurements; so a source that the prediction cannot judge, H P Hᵀ being larger, moves its factors
little. Wheels have two factors more, for the steps that add up: others judge them by what they say of the pose.

Innovations show what changes from one to the next. What stays for a while, as a scanner's bias does on a surface, they
do not; so only wheels, whose noise is described for all robots alike, are ever taken for better than stated.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation.planar import _measurement_kernels as kernels
from longreach.estimation.planar.ekf import frozen

_FIRST = 20.0  # information that the stated covariance itself counts for, in measurements of one component


class Noise(NamedTuple):
    """Logarithms of the factors on translations and on turns, the information gathered about them, `deviations`."""

    row: Float[np.ndarray, "7"]

    @property
    def log(self) -> Float[np.ndarray, "2"]:
        """The logarithms of the factors on the variances of translations and of turns (2,)."""
        return self.row[:2]

    @property
    def deviations(self) -> Float[np.ndarray, "3"]:
        """What the factors make of the standard deviations of x, y and θ (3,)."""
        return self.row[kernels.DEVIATIONS :]


NOMINAL = Noise(frozen(np.repeat([0.0, _FIRST, 1.0], [2, 2, 3])))


def process_noise(source: str) -> str:
    """Return the name under which the noise of the wheels' steps is kept; that of their readings has the source's."""
    return f"{source}, steps"


def inflated(noise: Noise, factors: Float[np.ndarray, "2"]) -> Noise:
    """Return a noise whose variances are these factors larger, as far as they may, and soon judged anew."""
    log = np.minimum(noise.log + np.log(factors), kernels.HIGHEST)
    information = np.where(factors > 1.0, _FIRST, noise.row[2:4])
    return Noise(frozen(np.concatenate([log, information, np.exp(0.5 * log)[[0, 0, 1]]])))


def scaled(covariance: Float[np.ndarray, "k k"], deviations: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
    """Return D R D."""
    return covariance * (deviations[:, None] * deviations)
