"""How noisy each source really is: factors on its covariance, estimated from the innovations while the filter runs.

A covariance R that is stated is taken as D R D with D² = diag of two factors, one for translations and one for turns.
Their logarithms follow the likelihood of the innovations, r ~ N(0, H P Hᵀ + D R D), by steps of the score over the
information gathered (stochastic approximation: Robbins & Monro 1951; Titterington 1984), which is forgotten over
`noise_memory` measurements; so a source that the prediction cannot judge, H P Hᵀ being larger, moves its factors
little. Wheels have two factors more, for the steps that add up: others judge them by what they say of the pose.

Innovations show what changes from one to the next. What stays for a while, as a scanner's bias does on a surface, they
do not; so only wheels, whose noise is described for all robots alike, are ever taken for better than stated.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation import _noise_kernels

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
        return self.row[_noise_kernels.DEVIATIONS :]


def _noise(*parts: np.ndarray) -> Noise:
    row = np.concatenate(parts)
    row.flags.writeable = False
    return Noise(row)


_NONE = np.zeros((0, 2, 3, 3))
NOMINAL = _noise(np.zeros(2), np.full(2, _FIRST), np.ones(3))


def process_noise(source: str) -> str:
    """Return the name under which the noise of the wheels' steps is kept; that of their readings has the source's."""
    return f"{source}, steps"


def inflated(noise: Noise, factors: Float[np.ndarray, "2"]) -> Noise:
    """Return a noise whose variances are these factors larger, as far as they may, and soon judged anew."""
    log = np.minimum(noise.log + np.log(factors), _noise_kernels.HIGHEST)
    return _noise(log, np.where(factors > 1.0, _FIRST, noise.row[2:4]), np.exp(0.5 * log)[[0, 0, 1]])


def scaled(covariance: Float[np.ndarray, "k k"], deviations: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
    """Return D R D."""
    return covariance * (deviations[:, None] * deviations)


def after_step(
    noise: Noise,
    covariance: Float[np.ndarray, "3 3"],
    pose: Float[np.ndarray, "3"],
    added: Float[np.ndarray, "2 3 3"],
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "2 3 3"]]:
    """Return D R D of a step of the wheels, and what steps have `added` to the covariance of the pose with this one."""
    Q, parts, A = np.empty((3, 3)), np.zeros((2, 3, 3)), np.empty((3, 3))
    _noise_kernels.step_noise(covariance, noise.row, pose, Q, parts, A)
    return Q, A @ added @ A.T + parts


def learned(
    known: Mapping[str, Noise],
    source: str,
    steps: Mapping[str, np.ndarray],
    observation: tuple[np.ndarray, ...],
    S: Float[np.ndarray, "k k"],
    coupled: Float[np.ndarray, "3"],
    memory: float,
    is_wheels: bool,
) -> Mapping[str, Noise]:
    """Return what is known of noises after a source's innovation r ~ N(0, S), by name.

    steps: by wheels, what their steps have added to the covariance of the pose, as far as that is coupled, where the
    innovation tells the pose. observation: r, H, R, and of each component whether it is a turn.
    """
    r, H, R, blocks = observation
    names = [source, *map(process_noise, steps)]
    rows = np.array([known.get(name, NOMINAL).row for name in names])
    added = np.array([*steps.values()]) if steps else _NONE
    _noise_kernels.learn(S, r, H, R, blocks, coupled, added, memory, is_wheels, rows)
    rows.flags.writeable = False
    return {**known, **dict(zip(names, map(Noise, rows), strict=True))}
