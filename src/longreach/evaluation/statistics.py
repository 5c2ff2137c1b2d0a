"""The few numbers that stand for many errors."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Statistics:
    """Of `count` errors, in their own unit; all but the count are NaN when there are none."""

    count: int
    rmse: float
    mean: float
    median: float
    std: float
    maximum: float


def statistics(errors: Float[np.ndarray, " n"]) -> Statistics:
    """Summarise errors (n,); `std` is the population's, about the mean."""
    if len(errors) == 0:
        return Statistics(0, *[np.nan] * 5)
    return Statistics(
        count=len(errors),
        rmse=float(np.sqrt(np.mean(errors**2))),
        mean=float(np.mean(errors)),
        median=float(np.median(errors)),
        std=float(np.std(errors)),
        maximum=float(np.max(errors)),
    )
