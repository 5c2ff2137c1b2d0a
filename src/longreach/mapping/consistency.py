"""Pairwise consistency of loop closures: which of them agree with each other, whatever the rest of the graph says.

Two closures and the odometry between their ends are a cycle; a true cycle's error is within its own covariance. The
largest set in which each two agree is taken. Source: Mangelson et al. 2018, "Pairwise consistent measurement set
maximization for robust multi-robot map merging".
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from longreach.geometry import se2

Edge = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]  # a relative pose, and the covariance of its ξ


def chained(*edges: Edge) -> Edge:
    """Return the product of relative poses whose errors are independent."""
    pose, covariance = np.zeros(3), np.zeros((3, 3))
    for z, S in edges:
        A = se2.adjoint(se2.inverse(z))
        pose, covariance = se2.compose(pose, z), A @ covariance @ A.T + S
    return pose, covariance


def reversed_edge(edge: Edge) -> Edge:
    """Return the relative pose the other way round."""
    A = se2.adjoint(edge[0])
    return se2.inverse(edge[0]), A @ edge[1] @ A.T


def cycle_chi2(*edges: Edge) -> float:
    """Return ξᵀ Σ⁻¹ ξ of a chain that should end where it began, 3 degrees of freedom."""
    pose, covariance = chained(*edges)
    xi = se2.log(pose)
    return float(xi @ np.linalg.solve(covariance, xi))


def largest_clique(agree: Bool[np.ndarray, "n n"], given: Sequence[int] = ()) -> list[int]:
    """Return the largest set of rows, with those given in it, in which each two agree; of equals the first."""
    n, best = len(agree), list[int]()
    beside = [sum(1 << int(j) for j in np.flatnonzero(agree[i]) if j != i) for i in range(n)]
    start = (1 << n) - 1
    for i in given:
        start &= beside[i]
    stack = [(list(given), start)]
    while stack:
        chosen, left = stack.pop()
        if len(chosen) > len(best):
            best = chosen
        if len(chosen) + left.bit_count() <= len(best):
            continue
        i = left.bit_length() - 1
        stack.append((chosen, left & ~(1 << i)))
        stack.append(([*chosen, i], left & beside[i]))
    return sorted(best)
