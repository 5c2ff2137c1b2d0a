"""How noisy each source really is: factors on its covariance, estimated from the innovations while the filter runs.

A covariance R that is stated is taken as D R D with D² = diag of two factors, one for translations and one for turns.
Their logarithms follow the likelihood of the innovations, r ~ N(0, H P Hᵀ + D R D), by steps of the score over the
information gathered (stochastic approximation: Robbins & Monro 1951; Titterington 1984), which is forgotten over
`noise_memory` measurements; so a source that the prediction cannot judge, H P Hᵀ being larger, moves its factors
little. Wheels have two factors more, for the steps that add up: others judge them by what they say of the pose.

Innovations show what changes from one to the next. What stays for a while, as a scanner's bias does on a surface, they
do not; so only wheels, whose noise is described for all robots alike, are ever taken for better than stated.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from longreach.estimation import _noise_kernels

_HIGHEST = math.log(25.0)  # what a stated variance may be too small by
LEAST = 0.25  # and too large by, of wheels
_FIRST = 20.0  # information that the stated covariance itself counts for, in measurements of one component
_OUTLIER = 4.0  # an innovation counts at most this many times what it should be on average


class Noise(NamedTuple):
    """Logarithms of the factors on translations and on turns (2,), and the information gathered about them (2,).

    deviations (3,): what the factors make of the standard deviations of x, y and θ.
    """

    log: Float[np.ndarray, "2"] = np.zeros(2)
    information: Float[np.ndarray, "2"] = np.full(2, _FIRST)
    deviations: Float[np.ndarray, "3"] = np.ones(3)


NOMINAL = Noise()


def process_noise(source: str) -> str:
    """Return the name under which the noise of the wheels' steps is kept; that of their readings has the source's."""
    return f"{source}, steps"


def inflated(noise: Noise, factors: Float[np.ndarray, "2"]) -> Noise:
    """Return a noise whose variances are these factors larger, as far as they may, and soon judged anew."""
    log = np.minimum(noise.log + np.log(factors), _HIGHEST)
    return Noise(log, np.where(factors > 1.0, _FIRST, noise.information), np.exp(0.5 * log)[[0, 0, 1]])


def scaled(covariance: Float[np.ndarray, "k k"], deviations: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
    """Return D R D."""
    return covariance * (deviations[:, None] * deviations)


def parts_of(R: Float[np.ndarray, "k k"], blocks: Int[np.ndarray, " k"]) -> Float[np.ndarray, "2 k k"]:
    """Return the derivatives of D R D over the logarithms of the two factors at R; blocks: 0 translation, 1 turn."""
    parts = np.empty((2, *R.shape))
    _noise_kernels.parts_of(R, blocks, parts)
    return parts


def learned(
    noises: Sequence[Noise],
    S: Float[np.ndarray, "k k"],
    r: Float[np.ndarray, " k"],
    own: Float[np.ndarray, "2 k k"],
    seen: Float[np.ndarray, "k 3"],
    added: Float[np.ndarray, "c 2 3 3"],
    memory: float,
    least: Sequence[float],
) -> list[Noise]:
    """Return the factors after an innovation r ~ N(0, S); least: the smallest that each may be.

    own: the `parts_of` S that are the first noise's. added: those of the others, in a pose of which r sees `seen`.
    """
    log, information = np.array([noise.log for noise in noises]), np.array([noise.information for noise in noises])
    deviations, lowest = np.empty((len(noises), 3)), np.log(least)
    if not _noise_kernels.learn(
        S, r, own, seen, added, _OUTLIER * len(r), memory, lowest, _HIGHEST, log, information, deviations
    ):
        return list(noises)
    return [Noise(*rows) for rows in zip(log, information, deviations, strict=True)]
