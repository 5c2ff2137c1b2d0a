"""A pose graph: poses of keyframes, and the relative poses that were measured between them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from longreach.errors import MappingError
from longreach.geometry import se2


@dataclass(frozen=True, eq=False)
class Edges:
    """Measured relative poses: z = T_i⁻¹ · T_j, one row an edge.

    i, j (m,): rows of the poses that it joins. z (m, 3) [m, m, rad]. covariance (m, 3, 3): of ξ = log(z⁻¹ · truth),
    order x y θ, in the frame of j; finite and positive definite.

    Raises:
        MappingError: shapes disagree, a number is not finite, an edge joins a pose with itself, or a covariance is not
            positive definite.
    """

    i: Int[np.ndarray, " m"]
    j: Int[np.ndarray, " m"]
    z: Float[np.ndarray, "m 3"]
    covariance: Float[np.ndarray, "m 3 3"]

    def __post_init__(self) -> None:
        m = len(self.i)
        for name, shape, kind in (("i", (m,), int), ("j", (m,), int), ("z", (m, 3), float)):
            object.__setattr__(self, name, frozen(getattr(self, name), shape, kind, f"pose graph's {name} of edges"))
        object.__setattr__(
            self, "covariance", frozen(self.covariance, (m, 3, 3), float, "pose graph's covariance of edges")
        )
        for e in np.flatnonzero(self.i == self.j).tolist():
            raise MappingError(f"Edge {e} joins pose {self.i[e]} with itself; an edge joins two poses.")
        for e in np.flatnonzero(~positive_definite(self.covariance)).tolist():
            raise MappingError(
                f"The covariance of edge {e}, of poses {self.i[e]} and {self.j[e]}, is not positive definite; "
                "give a direction that was not measured a large variance."
            )

    def __len__(self) -> int:
        return len(self.i)

    def __getitem__(self, rows: np.ndarray | slice) -> "Edges":
        """Return some of the edges."""
        return Edges(self.i[rows], self.j[rows], self.z[rows], self.covariance[rows])


def no_edges() -> Edges:
    """Return no edges."""
    return Edges(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros((0, 3, 3)))


def joined(*parts: Edges) -> Edges:
    """Return the edges of all parts, in order."""
    return Edges(
        np.concatenate([p.i for p in parts]),
        np.concatenate([p.j for p in parts]),
        np.concatenate([p.z for p in parts]),
        np.concatenate([p.covariance for p in parts]),
    )


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Poses of keyframes T_map_keyframe (n, 3) [m, m, rad] and the edges between them.

    odometry: edges that are taken as they are. closures: edges that can be withdrawn. The first pose of each part that
    edges hold together stays where it is: edges are relative and fix nothing else.

    Raises:
        MappingError: a pose is not finite, or an edge joins a pose that is not there.
    """

    poses: Float[np.ndarray, "n 3"]
    odometry: Edges
    closures: Edges

    def __post_init__(self) -> None:
        n = len(self.poses)
        object.__setattr__(self, "poses", frozen(self.poses, (n, 3), float, "pose graph's poses"))
        for edges in (self.odometry, self.closures):
            ends = np.concatenate([edges.i, edges.j])
            for end in ends[(ends < 0) | (ends >= n)].tolist():
                raise MappingError(f"An edge joins pose {end}, and the graph has poses 0 to {n - 1}.")

    @property
    def edges(self) -> Edges:
        """Return all edges, odometry first."""
        return joined(self.odometry, self.closures)


def information(covariance: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "m 3 3"]:
    """Return the inverses of covariances, by the adjugates of their correlations."""
    sigma = np.sqrt(np.einsum("mii->mi", covariance))
    C = covariance / (sigma[:, :, None] * sigma[:, None, :])
    a, b, c = C[:, 1, 0], C[:, 2, 0], C[:, 2, 1]
    out = np.empty_like(C)
    out[:, 0, 0], out[:, 1, 1], out[:, 2, 2] = 1 - c * c, 1 - b * b, 1 - a * a
    out[:, 0, 1] = out[:, 1, 0] = b * c - a
    out[:, 0, 2] = out[:, 2, 0] = a * c - b
    out[:, 1, 2] = out[:, 2, 1] = a * b - c
    determinant = out[:, 0, 0] + a * out[:, 0, 1] + b * out[:, 0, 2]
    return out / (determinant[:, None, None] * sigma[:, :, None] * sigma[:, None, :])


def residuals(poses: Float[np.ndarray, "n 3"], edges: Edges) -> Float[np.ndarray, "m 3"]:
    """Return what each edge lacks: ξ = log(z⁻¹ · T_i⁻¹ · T_j), in the frame of j."""
    return se2.difference(edges.z, se2.between(poses[edges.i], poses[edges.j]))


def chi2(poses: Float[np.ndarray, "n 3"], edges: Edges) -> Float[np.ndarray, " m"]:
    """Return ξᵀ Σ⁻¹ ξ of each edge."""
    e = residuals(poses, edges)
    return np.einsum("mi,mij,mj->m", e, information(edges.covariance), e)


def jacobians(
    poses: Float[np.ndarray, "n 3"], edges: Edges, xi: Float[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "m 3 3"], Float[np.ndarray, "m 3 3"]]:
    """Return A = ∂ξ/∂ξ_i and B = ∂ξ/∂ξ_j of the residuals ξ, for poses that move by T · exp(ξ_i).

    B = J_r⁻¹(ξ) = I + ad/2 + c ad², c = (1 − θ/2 cot θ/2)/θ², and A = −B Ad(T_j⁻¹ T_i).
    """
    ad = np.zeros((len(xi), 3, 3))
    ad[:, 0, 1], ad[:, 0, 2], ad[:, 1, 0], ad[:, 1, 2] = -xi[:, 2], xi[:, 1], xi[:, 2], -xi[:, 0]
    half = 0.5 * xi[:, 2]
    small = np.abs(half) < 1e-2
    t = np.where(small, 1.0, half)
    c = np.where(small, 1 / 12 + half * half / 180, (1 - t / np.tan(t)) / (4 * t * t))
    B = np.eye(3) + 0.5 * ad + c[:, None, None] * (ad @ ad)
    return -B @ adjoints(se2.between(poses[edges.j], poses[edges.i])), B


def adjoints(poses: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3 3"]:
    """Return Ad (k, 3, 3) of each pose: T · exp(ξ) = exp(Ad ξ) · T."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    Ad = np.zeros((len(poses), 3, 3))
    Ad[:, 0, 0], Ad[:, 0, 1], Ad[:, 0, 2] = c, -s, poses[:, 1]
    Ad[:, 1, 0], Ad[:, 1, 1], Ad[:, 1, 2] = s, c, -poses[:, 0]
    Ad[:, 2, 2] = 1.0
    return Ad


def innovation_chi2(
    poses: Float[np.ndarray, "n 3"], edges: Edges, between: Float[np.ndarray, "m 3 3"]
) -> Float[np.ndarray, " m"]:
    """Return the χ², 3 degrees of freedom, of edges that are not in a graph (or withdrawn there) against it.

    ξᵀ (Σ + B Σ_ij Bᵀ)⁻¹ ξ with B = J_r⁻¹(ξ) and Σ_ij = between (m, 3, 3), the covariances of T_i⁻¹ · T_j in the frame
    of j as the graph has them. To first order the sum of all errors grows by just that when the edge is added. Where
    Σ_ij is infinite, nothing speaks against the edge: 0.
    """
    xi = residuals(poses, edges)
    B = jacobians(poses, edges, xi)[1]
    known = np.isfinite(between[:, 0, 0])
    S = edges.covariance + B @ np.where(known[:, None, None], between, 0.0) @ B.transpose(0, 2, 1)
    return np.where(known, np.einsum("mi,mij,mj->m", xi, information(S), xi), 0.0)


def dead_reckoned(odometry: Edges, start: Float[np.ndarray, "3"], n: int) -> Float[np.ndarray, "n 3"]:
    """Return n poses from `start` along the edges that join each pose with the next.

    Raises:
        MappingError: an edge from a pose to the next one is missing.
    """
    step = {int(j): z for i, j, z in zip(odometry.i, odometry.j, odometry.z, strict=True) if j == i + 1}
    poses = [start]
    for k in range(1, n):
        if k not in step:
            raise MappingError(f"No odometry edge joins pose {k - 1} with pose {k}.")
        poses.append(se2.compose(poses[-1], step[k]))
    return np.array(poses).reshape(-1, 3)


def frozen(value: np.ndarray, shape: tuple[int, ...], kind: type, what: str) -> np.ndarray:
    """Return a read-only copy, int64 or float, or raise MappingError where its shape is another or it is not finite."""
    array = np.array(value, dtype=np.int64 if kind is int else float, order="C")
    if array.shape != shape:
        raise MappingError(f"The shape of a {what} is {array.shape}, expected {shape}.")
    if not np.all(np.isfinite(array)):
        raise MappingError(f"A {what} must be finite.")
    array.flags.writeable = False
    return array


def positive_definite(P: np.ndarray) -> np.ndarray:
    """Return (m,) which of the matrices (m, 3, 3) are symmetric and positive definite, by their leading minors."""
    a, b, c, d, e, f = P[:, 0, 0], P[:, 1, 0], P[:, 1, 1], P[:, 2, 0], P[:, 2, 1], P[:, 2, 2]
    scale = np.sqrt(np.abs(a * c)), np.sqrt(np.abs(a * f)), np.sqrt(np.abs(c * f))
    skew = np.abs(P - P.transpose(0, 2, 1))
    even = (skew[:, 1, 0] <= 1e-9 * scale[0]) & (skew[:, 2, 0] <= 1e-9 * scale[1]) & (skew[:, 2, 1] <= 1e-9 * scale[2])
    minor = a * c - b * b
    determinant = minor * f - a * e * e + 2 * b * d * e - c * d * d
    return even & (a > 0) & (minor > 0) & (determinant > 0)
