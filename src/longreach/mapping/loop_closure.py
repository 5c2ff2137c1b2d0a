"""Loop closure: where the joined scans of now fit a place that was seen before, within what the pose graph leaves open.

    window     3.5 σ of the relative pose between old keyframe and now, from the graph
    search     branch and bound over the window (Hess et al. 2016), and again for a second peak
    fit        point to line from the best pose, to the keyframes nearest to it; its covariance from the residuals
    gates      overlap, agreement, visibility both ways, uniqueness, χ² against the graph

A match that fails a gate keeps the reason. What passes is a closure only with others that agree: `mapper`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.mapping import _loop_closure_kernels as kernels
from longreach.mapping.keyframes import Place, matcher, seen_through
from longreach.odometry import _local_map_kernels as map_kernels
from longreach.odometry.local_map import LocalMap
from longreach.odometry.matchers.scan_matcher import Features, Fit, Prior

WINDOW = 3.5  # deviations of the relative pose: the true one is outside with 0.7 % (χ², 3 degrees of freedom)
CHI2 = 16.27  # 99.9 % of χ² with 3 degrees of freedom
APART = 1.0  # [m] between two peaks, and 1/3 rad: places that look the same are further apart
_CELL = map_kernels.CELL  # [m] of the search
_POINTS = 160  # of the joined scans that take part in the search, about
REGION = 30.0  # [m] from the middle of a region to its edge, of a map that is searched as a whole
_ANYWHERE = np.diag([(REGION / WINDOW) ** 2, (REGION / WINDOW) ** 2, 10.0**2])
_NEAR_ENOUGH = 15.0  # [m] to points that take part in that: further ones ask for finer turns
_CLEAR = 0.5  # agreement of a peak on a whole map
_LEAST = 0.3  # agreement of a peak: clutter and rounding to cells cost half of it
_ROUNDING = np.diag([_CELL**2, _CELL**2, 0.02**2])  # of the search, which the window grows by
NEAR = np.array([0.3, 0.3, 0.1])  # [m, m, rad] deviations of a fit's prior: wide against a cell
# Gates on a fit. Of 1276 matches on four real logs that were right 90 % pass; see benchmarks/mapping.py.
_OVERLAP = 0.4  # share of the returns that see a surface of the place, at least
_AGREES = 0.55  # of these, the share that agrees but for noise, at least
THROUGH = 0.2  # share of beams that pass through a surface of the other side, at most, beyond that of its own beams
_UNIQUE = 0.9  # a second peak above this part of the first: a place looks like another one


class Evidence(NamedTuple):
    """What speaks for a match, beside the gates.

    agreement: of the peak; second: of the best one elsewhere, as far as it is above the gate; overlap, agrees, through,
    through_back: shares of beams; chi2: against the graph; blind: directions that the scans do not show; window [m]:
    half its longest axis.
    """

    agreement: float
    second: float
    overlap: float
    agrees: float
    through: float
    through_back: float
    chi2: float
    blind: int
    window: float


@dataclass(frozen=True, eq=False)
class Match:
    """Keyframe j as seen from keyframe i < j: pose (3,), covariance (3, 3) of ξ; the gate that refuses it, or ""."""

    i: int
    j: int
    pose: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    evidence: Evidence
    gate: str


class Peak(NamedTuple):
    """A pose (3,) in the frame of a place, and how well joined scans agree with it there, 0 to 1."""

    pose: np.ndarray
    agreement: float


class Window:
    """The poses of now in the frame of a local map that the graph allows, prepared to be searched."""

    def __init__(
        self,
        place: LocalMap,
        points: Float[np.ndarray, "2 m"],
        mean: Float[np.ndarray, "3"],
        covariance: Float[np.ndarray, "3 3"],
    ) -> None:
        """Prepare the search of points (2, m) in the base's frame about a mean (3,) with a covariance (3, 3) of ξ."""
        first, field, _ = place.field
        self.levels = np.empty((kernels.LEVELS, field.shape[0] // 2, field.shape[1] // 2), np.uint8)
        kernels.pyramid(field, self.levels)
        corner = place.surfaces.origin + first * (_CELL / map_kernels.FINE)
        R = np.eye(3)
        R[:2, :2] = [[math.cos(mean[2]), -math.sin(mean[2])], [math.sin(mean[2]), math.cos(mean[2])]]
        covariance = R @ covariance @ R.T + _ROUNDING
        self.mean, self.information = mean, np.linalg.inv(covariance)
        farthest = max(float(np.sqrt((points**2).sum(axis=0).max())), 1.0)
        self.steps = _CELL, math.acos(1.0 - 0.5 * (_CELL / farthest) ** 2)  # (7) of Hess et al.
        half = np.minimum(WINDOW * np.sqrt(np.diag(covariance)), [np.inf, np.inf, math.pi])
        self.sizes = tuple(int(n) for n in np.ceil(half / [_CELL, *self.steps]))
        self.cells = np.empty((2 * self.sizes[2] + 1, 2, points.shape[1]), np.int64)
        kernels.place_points(points, corner, _CELL, mean, self.sizes, self.steps[1], self.cells)
        self.top = min(kernels.LEVELS - 1, int(math.log2(2 * max(self.sizes[:2]) + 1)))
        width = 1 << self.top
        roots = np.empty((len(self.cells), *(2 * n // width + 1 for n in self.sizes[:2])))
        kernels.root_bounds(self.levels[self.top], self.cells, width, self.sizes, roots)
        self.roots = roots.ravel()
        self.order = np.argsort(-self.roots)

    def best(
        self,
        least: float,
        other: Float[np.ndarray, "3"] | None = None,
        along: Float[np.ndarray, "2"] | None = None,
    ) -> Peak | None:
        """Return the best peak above `least`, apart from another pose (3,); distances `along` (2,) do not count."""
        apart, found = (-1.0, np.zeros(3)) if other is None else (APART, other - self.mean)
        at = np.zeros(3)
        value = kernels.descend(
            self.levels, self.cells, self.top, self.sizes, self.roots, self.order, self.steps,
            self.information, WINDOW**2, apart, found, np.zeros(2) if along is None else along, least, at,
        )  # fmt: skip
        return Peak(self.mean + at, value) if value > least else None


def sampled(scan: Features) -> Float[np.ndarray, "2 m"]:
    """Return points of joined scans that lie evenly along their surfaces."""
    points = scan.values[:2]
    cells = np.floor(points / (2 * _CELL)).astype(np.int64)
    _, at = np.unique((cells[0] << 32) + cells[1], return_index=True)
    return np.ascontiguousarray(points[:, np.sort(at[:: max(len(at) // _POINTS, 1)])])


def fitted(
    scan: Features, to: LocalMap, pose: np.ndarray, free: np.ndarray, sigma: np.ndarray = NEAR, joined: int = 1
) -> Fit:
    """Fit joined scans to a local map about a pose (3,); free (3,): variances along directions that they do not see."""
    return matcher(joined).fit(scan, to, Prior(pose, sigma, free, free), pose)


def looked_through(scan: Features, place: Place, pose: np.ndarray) -> float:
    """Return the share of a scan's beams that pass through surfaces of a place, in which the base is at a pose.

    The share of the place's own scans that do so does not count: people who walk about are surfaces, too.
    """
    return max(seen_through(scan, place.local_map, pose) - place.changing, 0.0)


def compared(
    place: Place,
    now: Place,
    mean: Float[np.ndarray, "3"],
    covariance: Float[np.ndarray, "3 3"],
    nearest: Callable[[Float[np.ndarray, "3"]], tuple[Place, Float[np.ndarray, "3"]]],
) -> Match | None:
    """Look for now in a place, where the graph expects it at a mean (3,) with a covariance (3, 3) of ξ.

    nearest: gives for a pose in the frame of the place the place whose middle is nearest to it, and the pose of that
    middle in the frame of this one. Returns None where nothing in the window agrees.
    """
    scan, free = now.joined, WINDOW**2 * np.diag(covariance)
    searched = Window(place.local_map, sampled(scan), mean, covariance)
    peak = searched.best(_LEAST)
    if peak is None:
        return None
    fit = fitted(scan, place.local_map, peak.pose, free, joined=len(now.rows))
    if fit.rows == 0:
        return None
    longest = WINDOW * math.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[1])
    second = searched.best(_UNIQUE * peak.agreement, peak.pose, _blind_axis(fit)) if longest > 0.5 * APART else None
    nearer, middle = nearest(fit.pose)
    if nearer.middle != place.middle:
        place, mean = nearer, se2.between(middle, mean)
        fit = fitted(scan, place.local_map, se2.between(middle, fit.pose), free, joined=len(now.rows))
    overlap = fit.rows / scan.count
    found = fit.covariance + now.bending + place.bending
    xi = se2.difference(mean, fit.pose)
    evidence = Evidence(
        peak.agreement, 0.0 if second is None else second.agreement, overlap, fit.inlier_ratio / max(overlap, 1e-9),
        looked_through(scan, place, fit.pose),
        looked_through(place.keyframes[-1].features, now, se2.inverse(fit.pose)),
        float(xi @ np.linalg.solve(covariance + found, xi)), len(fit.directions), longest,
    )  # fmt: skip
    if not math.isfinite(fit.scale) or not np.isfinite(evidence.chi2):
        return None
    return Match(place.middle, now.middle, fit.pose, found, evidence, gate_of(evidence))


def found_anywhere(
    regions: Sequence[LocalMap],
    now: Place,
    nearest: Callable[[Float[np.ndarray, "3"]], tuple[Place, Float[np.ndarray, "3"]]],
) -> Match | None:
    """Look for now on a whole map, of which regions show a part each, in the frame of the map.

    nearest: as of `compared`, for poses on the map. What is blind in a direction may be anywhere along it, and is not
    unique. Returns None where nothing on the map agrees well.
    """
    scan, peak = now.joined, None
    points = sampled(scan)
    points = np.ascontiguousarray(points[:, np.hypot(*points) < _NEAR_ENOUGH])
    if points.shape[1] == 0:
        return None
    for region in regions:
        searched = Window(region, points, np.array([*region.poses[-1, :2], 0.0]), _ANYWHERE)
        peak = searched.best(_CLEAR if peak is None else peak.agreement) or peak
    if peak is None:
        return None
    place, middle = nearest(peak.pose)
    at = se2.between(middle, peak.pose)
    fit = fitted(scan, place.local_map, at, np.full(3, 100.0), joined=len(now.rows))
    if fit.rows == 0 or not math.isfinite(fit.scale):
        return None
    overlap = fit.rows / scan.count
    evidence = Evidence(
        peak.agreement, 0.0, overlap, fit.inlier_ratio / max(overlap, 1e-9),
        looked_through(scan, place, fit.pose),
        looked_through(place.keyframes[-1].features, now, se2.inverse(fit.pose)),
        0.0, len(fit.directions), REGION,
    )  # fmt: skip
    if not gate_of(evidence):
        evidence = evidence._replace(second=_second_anywhere(regions, points, peak) if not len(fit.directions) else 1.0)
    covariance = fit.covariance + now.bending + place.bending
    return Match(place.middle, now.middle, fit.pose, covariance, evidence, gate_of(evidence))


def _second_anywhere(regions: Sequence[LocalMap], points: np.ndarray, peak: Peak) -> float:
    """Return the best agreement elsewhere on a map, 0 where it is far below the peak's."""
    second = 0.0
    for region in regions:  # headings about that of the peak: it is then not found again a full turn away
        searched = Window(region, points, np.array([*region.poses[-1, :2], peak.pose[2]]), _ANYWHERE)
        other = searched.best(max(second, _UNIQUE * peak.agreement), peak.pose)
        second = second if other is None else other.agreement
    return second


def chi2_of(matches: Sequence[Match], poses: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " m"]:
    """Return ξᵀ Σ⁻¹ ξ of each match, 3 degrees of freedom, where keyframes are at poses (n, 3)."""
    return np.array(
        [
            (xi := se2.difference(m.pose, se2.between(poses[m.i], poses[m.j]))) @ np.linalg.solve(m.covariance, xi)
            for m in matches
        ]
    )


def gate_of(e: Evidence) -> str:
    """Return the gate that refuses a match, or ""."""
    if e.overlap < _OVERLAP:
        return "overlap"
    if e.agrees < _AGREES:
        return "agreement"
    if max(e.through, e.through_back) > THROUGH:
        return "visibility"
    if e.second > 0.0:
        return "uniqueness"
    return "chi2" if e.chi2 > CHI2 else ""


def reason_of(match: Match) -> str:
    """Return why a gate refuses a match, as a sentence."""
    e = match.evidence
    return {
        "overlap": f"Only {100 * e.overlap:.0f} % of the returns see a surface of the place.",
        "agreement": f"Only {100 * e.agrees:.0f} % of the returns on surfaces of the place agree with them.",
        "visibility": f"{100 * max(e.through, e.through_back):.0f} % of the beams pass through surfaces.",
        "uniqueness": f"A second place agrees {e.second / max(e.agreement, 1e-9):.2f} times as well.",
        "chi2": f"It is off the graph by χ² = {e.chi2:.1f}; {CHI2} is the limit.",
        "": "",
    }[match.gate]


def _blind_axis(fit: Fit) -> Float[np.ndarray, "2"]:
    """Return the unit vector along which the scan shows nothing, in the frame of the map; 0 where there is none."""
    if len(fit.directions) == 0:
        return np.zeros(2)
    (x, y, _), c, s = fit.directions[0].tolist(), math.cos(fit.pose[2]), math.sin(fit.pose[2])
    size = math.hypot(x, y)
    return np.array([c * x - s * y, s * x + c * y]) / size if size > 0.5 else np.zeros(2)
