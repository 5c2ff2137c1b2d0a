"""The convex subproblem (4.22) of one iteration: quadratic cost, linear constraints, a box around the last q.

The equations are eliminated first: d = d₀ + Z z, z being the few directions that they leave free. What is left goes to
daqp where it is one waypoint's (here), and to a solver of ours where it couples many (`sequence`). Where the rows
contradict each other, `elastic` lets all of them but the box give way, at the price of the merit function's penalties.
"""

from dataclasses import dataclass, replace

import daqp
import numpy as np
from jaxtyping import Float

EXACT = 1e-10


@dataclass(frozen=True, eq=False)
class Difference:
    """A link at the present trajectory: coefficients (k, width), and bounds (k, n) of the change of its value.

    Of a cost, the bounds are empty and curvature is 2 · weight, for all values or for each of them (k, n).
    """

    coefficients: Float[np.ndarray, "k width"]
    lower: Float[np.ndarray, "k2 n"]
    upper: Float[np.ndarray, "k2 n"]
    curvature: float | np.ndarray = 0.0

    def of(self, x: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "k n"]:
        """Return the difference's value at a trajectory."""
        k = len(self.coefficients)
        return sum(
            (self.coefficients[:, i, None] * x[i : i + k] for i in range(self.coefficients.shape[1])),
            np.zeros((k, x.shape[1])),
        )

    def pull(self, x: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N n"]:
        """Return the gradient of ½ Σ curvature · difference² at a trajectory."""
        return self.transposed(self.curvature * self.of(x), len(x))

    def energy(self, x: Float[np.ndarray, "N n"]) -> float:
        """Return ½ Σ curvature · difference² at a trajectory."""
        return 0.5 * float(np.sum(self.curvature * self.of(x) ** 2))

    def about(self, x: Float[np.ndarray, "N n"]) -> "Difference":
        """Return it with bounds that count from where the trajectory x is."""
        value = self.of(x)
        return replace(self, lower=self.lower - value, upper=self.upper - value)

    def transposed(self, y: Float[np.ndarray, "k n"], N: int) -> Float[np.ndarray, "N n"]:
        """Return what multipliers of the difference exert on each waypoint."""
        out = np.zeros((N, y.shape[1]))
        k = len(self.coefficients)
        for i in range(self.coefficients.shape[1]):
            out[i : i + k] += self.coefficients[:, i, None] * y
        return out


@dataclass(frozen=True, eq=False)
class Subproblem:
    """min gᵀd + ½ zᵀH z + links' costs, d = d₀ + Z z, lower ≤ G d ≤ upper, and the limits of links.

    All are over N waypoints: g, d0 (N, n), Z (N, n, p), H (N, p, p), G (N, r, n); the last n rows of G are the joints'
    limits. The trust region is |z| ≤ reach; exact: how exact the solution must be.
    """

    g: Float[np.ndarray, "N n"]
    d0: Float[np.ndarray, "N n"]
    Z: Float[np.ndarray, "N n p"]
    H: Float[np.ndarray, "N p p"]
    G: Float[np.ndarray, "N r n"]
    lower: Float[np.ndarray, "N r"]
    upper: Float[np.ndarray, "N r"]
    reach: float
    exact: float
    costs: tuple[Difference, ...] = ()
    limits: tuple[Difference, ...] = ()


@dataclass(frozen=True, eq=False)
class Step:
    """d (N, n) with the multipliers of the rows (N, r), of the links (k, n) each, and of the equations (N, m_e).

    The last are empty where the equations were eliminated.
    """

    d: Float[np.ndarray, "N n"]
    rows: Float[np.ndarray, "N r"]
    links: tuple[np.ndarray, ...] = ()
    equations: Float[np.ndarray, "N e"] | None = None


def one_waypoint(
    H: Float[np.ndarray, "p p"], g: Float[np.ndarray, " p"], G: Float[np.ndarray, "r p"],
    lower: Float[np.ndarray, " m"], upper: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " r"]] | None:  # fmt: skip
    """Return z and the rows' multipliers by daqp, or None where the rows contradict each other.

    The first p bounds are those of z itself.
    """
    z, _, flag, info = daqp.solve(H, g, G, upper, lower, primal_tol=EXACT)
    return (z, info["lam"][len(z) :]) if flag == 1 else None
