"""How noisy each source really is: factors on its covariance, estimated from the innovations while the filter runs.

A covariance R that is stated is taken as D R D with D² = diag of two factors, one for translations and one for turns.
Their logarithms follow the likelihood of the innovations, r ~ N(0, H P Hᵀ + D R D), by steps of the score over the
information gathered (stochastic approximation: Robbins & Monro 1951; Titterington 1984), which is forgotten over
`noise_memory` measurements; so a source that the prediction cannot judge, H P Hᵀ being larger, moves its factors
little. A counter has two factors more, for the steps that add up: others judge them by what they say of the pose.

Innovations show what changes from one to the next. What stays for a while, as a scanner's bias does on a surface, they
do not; so only a counter, whose noise is described for all robots alike, is ever taken for better than it says.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from longreach.estimation import _noise_kernels

_MOST = 25.0  # what a stated variance may be too small by
LEAST = 0.25  # and too large by, of a counter
_FIRST = 20.0  # information that the stated covariance itself counts for, in measurements of one component
_OUTLIER = 4.0  # an innovation counts at most this many times what it should be on average


class Noise(NamedTuple):
    """Logarithms of the factors on translations and on turns (2,), and the information gathered about them (2,)."""

    log: Float[np.ndarray, "2"] = np.zeros(2)
    information: Float[np.ndarray, "2"] = np.full(2, _FIRST)

    @property
    def deviations(self) -> Float[np.ndarray, "3"]:
        """Factors (3,) on the standard deviations of x, y and θ."""
        return np.exp(0.5 * self.log)[[0, 0, 1]]


AS_STATED = Noise()


def scaled(covariance: Float[np.ndarray, "k k"], deviations: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
    """Return D R D."""
    return covariance * np.outer(deviations, deviations)


def parts_of(R: Float[np.ndarray, "k k"], blocks: Int[np.ndarray, " k"]) -> Float[np.ndarray, "2 k k"]:
    """Return the derivatives of D R D over the logarithms of the two factors at R; blocks: 0 translation, 1 turn."""
    E = np.array([blocks == 0, blocks == 1], dtype=float)
    return 0.5 * (E[:, :, None] + E[:, None, :]) * R


def learned(
    noises: tuple[Noise, ...],
    S: Float[np.ndarray, "k k"],
    r: Float[np.ndarray, " k"],
    parts: Float[np.ndarray, "m k k"],
    memory: float,
    least: Sequence[float],
) -> tuple[Noise, ...]:
    """Return the factors after an innovation r ~ N(0, S); parts: two of S for each noise, least: their bounds."""
    slope, information = np.empty(len(parts)), np.empty(len(parts))
    if not _noise_kernels.score(S, r, parts, _OUTLIER * len(r), slope, information):
        return noises
    after = []
    for i, noise in enumerate(noises):
        g, new = slope[2 * i : 2 * i + 2], information[2 * i : 2 * i + 2]
        gathered = np.minimum(noise.information + new, memory)
        log = np.clip(noise.log + g / gathered, math.log(least[i]), math.log(_MOST))
        after.append(Noise(log, gathered))
    return tuple(after)
