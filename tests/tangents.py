"""Tangent vectors drawn in the four regimes where the formulas of a rotation group behave differently."""

from functools import partial

import numpy as np
from hypothesis import strategies as st

_NEAR = 1e-7  # [rad], [m]; the distance from the identity and from π


def _vector(size: int, length: float, rng: np.random.Generator) -> np.ndarray:
    direction = rng.normal(size=size)
    return length * direction / np.linalg.norm(direction)


def _uniform(linear: int, angular: int, rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(0.0, np.pi - 1e-3)
    return np.concatenate([rng.uniform(-10.0, 10.0, linear), _vector(angular, angle, rng)])


def _normal(linear: int, angular: int, rng: np.random.Generator) -> np.ndarray:
    return rng.normal(scale=0.5, size=linear + angular)


def _near_identity(linear: int, angular: int, rng: np.random.Generator) -> np.ndarray:
    return _NEAR * rng.normal(size=linear + angular)


def _near_pi(linear: int, angular: int, rng: np.random.Generator) -> np.ndarray:
    return np.concatenate([rng.uniform(-10.0, 10.0, linear), _vector(angular, np.pi - _NEAR * rng.uniform(), rng)])


def tangents(linear: int, angular: int) -> st.SearchStrategy[np.ndarray]:
    """Return a strategy for [v; ω] with |ω| < π: uniform, normal, near the identity and near π, in equal parts."""
    regimes = [partial(draw, linear, angular) for draw in (_uniform, _normal, _near_identity, _near_pi)]
    seeds = st.integers(0, 2**32 - 1)
    return st.builds(lambda draw, seed: draw(np.random.default_rng(seed)), st.sampled_from(regimes), seeds)


def away_from_pi(tangent: np.ndarray, angular: int) -> np.ndarray:
    """Return the tangent with its rotation shortened to π - 0.01, so that a finite difference does not jump."""
    angle = np.linalg.norm(tangent[-angular:])
    return tangent if angle < np.pi - 0.01 else np.append(tangent[:-angular], tangent[-angular:] * 0.99)
