"""A map prepared for localising in it: the surfaces about each place, and how well the map knows where each is.

The covariance of a keyframe is that against the frame in which the whole map fits best, as the rigid alignment of a
trajectory to its truth takes it: against its first keyframe alone, all the others share the error of that one.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping import _evidence_kernels as evidence_kernels
from longreach.mapping import _occupancy_kernels as occupancy_kernels
from longreach.mapping import solver
from longreach.mapping.keyframes import MATCHER
from longreach.mapping.map_file import Map
from longreach.mapping.occupancy import Occupancy
from longreach.mapping.pose_graph import adjoints, information, jacobians, residuals
from longreach.measurement import LaserScan
from longreach.odometry import local_map
from longreach.odometry._local_map_kernels import CELL
from longreach.odometry.local_map import LocalMap
from longreach.odometry.matchers.scan_matcher import Features
from longreach.odometry.scan_geometry import ScanGeometry, same_kind, scan_geometry, share_of_a_beam

FAR = 10.0  # [m] from the nearest keyframe: beyond it a pose is off the map
_REACH, _MOST = 4.0, 20  # [m] about a keyframe, and how many of the others there make its reference
_KEPT = 128  # references
_RUN = 2  # neighbouring beams that contradict a map: a single one grazes an edge
# Of places from which a grid is looked at: their distance and free space about them [m], beams, how far they reach [m].
_SPACING, _ROOM, _DRAWN, _FARTHEST = 1.0, 0.3, 720, 20.0
_FEWEST = 12  # returns of a scan that shows a place


class Evidence(NamedTuple):
    """How many beams of a scan a map explains, and how many contradict it; where the others end, it knows nothing."""

    explained: int
    against: int
    beams: int

    @property
    def share(self) -> float:
        """Of these beams, those that are explained, more than 0 and less than 1."""
        return (self.explained + 0.5) / (self.explained + self.against + 1.0)

    @property
    def covered(self) -> float:
        """The share of the beams that end or pass where the map knows something."""
        return (self.explained + self.against) / max(self.beams, 1)


class Space(NamedTuple):
    """Cells (n, m) of `CELL`, free, occupied or unknown, as `_evidence_kernels` numbers them, from a corner (2,)."""

    corner: Float[np.ndarray, "2"]
    cells: UInt8[np.ndarray, "n m"]


@dataclass(frozen=True, eq=False)
class KnownMap:
    """Keyframes at poses T_map_base (n, 3) with covariances (n, 3, 3) of ξ, and what each sees in the base's frame.

    cell [m]: of the grid from which surfaces are, 0 where they are of scans. rough (3, 3): covariance of an error that
    fits about one place share because of it.
    """

    poses: Float[np.ndarray, "n 3"]
    covariances: Float[np.ndarray, "n 3 3"]
    features: tuple[Features, ...]
    cell: float = 0.0
    rough: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.zeros((3, 3)))
    references: dict[int, LocalMap] = field(default_factory=dict)  # a cache: what is in it follows from the rest

    @cached_property
    def surfaces(self) -> tuple[local_map.Keyframe, ...]:
        """What each keyframe sees, at its pose on the map."""
        return tuple(local_map.keyframe(f, pose) for f, pose in zip(self.features, self.poses, strict=True))

    @cached_property
    def space(self) -> Space:
        """What is known to be free or occupied, by the beams of all keyframes."""
        ends, starts = [], []
        for f, (x, y, t) in zip(self.features, self.poses.tolist(), strict=True):
            c, s = math.cos(t), math.sin(t)
            p, d = f.values[:2], f.values[:2] - f.values[2:4] * f.values[4]
            for to, (px, py) in ((ends, p), (starts, d)):
                to.append(np.column_stack([x + c * px - s * py, y + s * px + c * py]))
        start, end = np.concatenate(starts) / CELL, np.concatenate(ends) / CELL
        low = np.floor(np.minimum(start.min(axis=0), end.min(axis=0))) - 1
        size = tuple((np.ceil(np.maximum(start.max(axis=0), end.max(axis=0))) - low + 2).astype(int).tolist())[::-1]
        hits, passes = np.zeros(size, np.int32), np.zeros(size, np.int32)
        occupancy_kernels.trace(start - low, end - low, np.ones(len(end), bool), hits, passes)
        cells = np.where(passes > 0, evidence_kernels.FREE, evidence_kernels.UNKNOWN)
        cells[hits > 0] = evidence_kernels.OCCUPIED  # by some beam: walls that others graze, and what was there once
        return Space(low * CELL, np.ascontiguousarray(cells.T.astype(np.uint8)))

    def evidence(self, k: int, scan: Features, pose: Float[np.ndarray, "3"]) -> Evidence:
        """Compare the beams of a scan at a pose (3,) on the map with what the keyframes about keyframe k see."""
        reference, verdicts = self.reference(k), np.empty(scan.count, np.int64)
        gate = MATCHER.settings.gate * min(scan.noise, 1.2 * reference.noise)  # as the matcher's
        at, (corner, cells) = se2.between(self.poses[k], pose), self.space
        tolerance, surfaces = max(gate, 0.5 * CELL) + self.cell, reference.surfaces
        evidence_kernels.judge_beams(scan.values, scan.count, tolerance, at, surfaces, pose, corner, cells, verdicts)
        explained, against = evidence_kernels.count_beams(verdicts, _RUN)
        return Evidence(explained, against, scan.count)

    def nearest(self, pose: Float[np.ndarray, "3"]) -> tuple[int, float]:
        """Return the keyframe nearest to a pose, and how far away it is [m]."""
        distance = np.hypot(*(self.poses[:, :2] - pose[:2]).T)
        k = int(np.argmin(distance))
        return k, float(distance[k])

    def reference(self, k: int) -> LocalMap:
        """Return the surfaces that the keyframes about keyframe k see, in its frame."""
        if k not in self.references:
            if len(self.references) >= _KEPT:
                self.references.pop(next(iter(self.references)))
            distance = np.hypot(*(self.poses[:, :2] - self.poses[k, :2]).T)
            distance[k] = -1.0  # a local map lies about its last keyframe
            rows = [q for q in np.argsort(distance)[:_MOST][::-1].tolist() if distance[q] < _REACH]
            at = se2.between(np.broadcast_to(self.poses[k], (len(rows), 3)), self.poses[rows])
            seen = (self.surfaces[q] for q in rows)
            parts = [local_map.Keyframe(x, s.elements, s.noise) for x, s in zip(at, seen, strict=True)]
            self.references[k] = local_map.merged(parts)
        return self.references[k]


def prepared(map_: Map) -> KnownMap:
    """Prepare a map.

    Raises:
        MappingError: none of its scans shows anything.
    """
    features, geometry, before = [], None, None
    for scan, session, twist in zip(map_.scans, map_.session.tolist(), map_.twists, strict=True):
        mount = map_.sessions[session].mounts[scan.frame]
        if geometry is None or not (same_kind(scan, geometry) and mount is before):
            geometry, before = scan_geometry(scan, mount, 5), mount
        features.append(features_of(scan, geometry, twist))
    if max(f.count for f in features) < _FEWEST:
        raise MappingError("No scan of the map shows anything; map a recording in which the laser sees walls.")
    return KnownMap(map_.graph.poses, covariances_of(map_), tuple(features))


def drawn(grid: Occupancy) -> KnownMap:
    """Prepare an occupancy grid: what a laser would see from places in its free space, every metre.

    A surface lies anywhere in its cell: variance 1/12 of its square. All cells of a wall along the grid are off alike,
    so that this does not average out over a scan. One half of the variance is taken to be common to the whole map, and
    one to fits about one place; of the heading, with walls as long as a beam usually is.

    Raises:
        MappingError: no cell is occupied, or no free place is near one.
    """
    from scipy.ndimage import minimum_filter  # here, for it takes long to import

    size, (rows, columns) = grid.resolution, grid.occupied.shape
    step = max(round(_SPACING / size), 1)
    r, c = np.meshgrid(np.arange(step // 2, rows, step), np.arange(step // 2, columns, step), indexing="ij")
    roomy = np.asarray(minimum_filter(grid.free, 2 * math.ceil(_ROOM / size) + 1, mode="constant"), dtype=bool)
    is_place = roomy[r, c].ravel()
    places = np.stack([c.ravel() + 0.5, r.ravel() + 0.5], axis=1)[is_place]
    angles = -math.pi + 2.0 * math.pi / _DRAWN * np.arange(_DRAWN)
    directions, ranges = np.column_stack([np.cos(angles), np.sin(angles)]), np.empty((len(places), _DRAWN))
    occupancy_kernels.cast(places, directions, grid.occupied, grid.free, _FARTHEST / size, ranges)
    seen = np.isfinite(ranges).sum(axis=1) >= _FEWEST
    if not seen.any():
        raise MappingError("The map is empty: no free cell of its grid sees an occupied one.")
    shape = -math.pi, 2.0 * math.pi / _DRAWN
    scans = [LaserScan(0.0, size * beams, *shape, range_max=_FARTHEST) for beams in ranges[seen]]
    geometry, noise = scan_geometry(scans[0], np.eye(4), 5), size / math.sqrt(12.0)
    poses = np.column_stack([size * places[seen], np.zeros(seen.sum())])
    wall = size * float(np.median(ranges[np.isfinite(ranges)]))
    half = 0.5 * np.diag(np.array([noise, noise, noise / wall]) ** 2)
    features = (features_of(scan, geometry, np.zeros(3)) for scan in scans)
    return KnownMap(
        se2.compose(np.broadcast_to(grid.origin, poses.shape), poses),
        np.broadcast_to(half, (len(poses), 3, 3)),
        tuple(replace(found, noise=max(found.noise, noise)) for found in features),
        cell=size,
        rough=half,
    )


def features_of(scan: LaserScan, geometry: ScanGeometry, twist: Float[np.ndarray, "3"]) -> Features:
    """Return the features of a scan in the base's frame; twist (3,): of the base during the sweep."""
    share = share_of_a_beam(scan, 1.0)
    motion = se2.adjoint(se2.inverse(geometry.pose_base_laser)) @ twist * (1.0 if share > 0.0 else 0.0)
    found = MATCHER.features(scan, geometry, motion, share)
    return replace(found, values=np.ascontiguousarray(found.values[:, : found.count]))


def covariances_of(map_: Map) -> Float[np.ndarray, "n 3 3"]:
    """Return the covariance of each keyframe's ξ against the rigid motion by which all positions fit best.

    That motion a (3,) takes a part of all errors: ξ'_k = ξ_k − Ad(T_k⁻¹) a with a = W ξ, a least squares fit.
    """
    from scipy.sparse import coo_matrix  # here, for it takes long to import
    from scipy.sparse.linalg import splu

    solved = solver.optimize(map_.graph, map_.weights)
    poses, edges, free = solved.poses, solved.graph.edges, ~solved.factor.fixed
    n = len(poses)
    Ad = adjoints(se2.between(poses, np.zeros((n, 3))))  # of T_k⁻¹
    weighed = np.linalg.inv(np.einsum("kab,kac->bc", Ad[:, :2], Ad[:, :2]) + 1e-9 * np.eye(3))
    W = (Ad * np.array([[1.0], [1.0], [0.0]])) @ weighed  # (n, 3, 3): a = Σ W_kᵀ ξ_k, of positions alone
    S, C = solver.marginals(solved), np.zeros((n, 3, 3))
    if free.any():
        row = np.cumsum(free) - 1
        J = np.stack(jacobians(poses, edges, residuals(poses, edges)), axis=1)  # (m, 2, 3, 3)
        weights = np.concatenate([np.ones(len(solved.graph.odometry)), solved.weights])
        H = np.einsum("meab,m,mac,mfcd->mefbd", J, weights, information(edges.covariance), J)
        ends = np.stack([edges.i, edges.j], axis=1)
        at = 3 * row[ends][:, :, None] + np.arange(3)
        rows = np.broadcast_to(at[:, :, None, :, None], H.shape)
        columns = np.broadcast_to(at[:, None, :, None, :], H.shape)
        kept = np.broadcast_to((free[ends][:, :, None] & free[ends][:, None, :])[..., None, None], H.shape)
        entries = H[kept], (rows[kept], columns[kept])
        size = 3 * int(free.sum())
        C[free] = splu(coo_matrix(entries, shape=(size, size)).tocsc()).solve(W[free].reshape(-1, 3)).reshape(-1, 3, 3)
    V = np.einsum("kba,kbc->ac", W, C)
    part = C @ Ad.transpose(0, 2, 1)
    S = S - part - part.transpose(0, 2, 1) + Ad @ V @ Ad.transpose(0, 2, 1)
    return 0.5 * (S + S.transpose(0, 2, 1))
