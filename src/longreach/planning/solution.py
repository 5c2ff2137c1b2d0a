"""What a planner answers with, and how far it can be trusted."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Solution:
    """A configuration with its certificate; not converging is a value, too.

    q (n,) [rad or m]: the best found; status: a sentence; iterations: how many it took; residuals: what is left of each
    error; violated: the names of those that are not met.
    """

    q: Float[np.ndarray, " n"]
    status: str
    converged: bool
    iterations: int
    residuals: Mapping[str, float]
    violated: tuple[str, ...] = ()
