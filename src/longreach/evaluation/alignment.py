"""Bring an estimate and the truth together: the same instants, and the same frame."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from longreach.errors import LongreachError
from longreach.geometry import se2
from longreach.trajectory import PoseTrajectory

# Bridges a scan or two that were lost (5 Hz logs), not a pause in the recording; at 1 m/s a robot that turns leaves the
# interpolated path by less than 0.1 m.
LONGEST_GAP = 1.0

Align = Literal["rigid", "first", "none"]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Poses of an estimate and of the truth at the same instants.

    clock: never backwards [s]. estimate, truth: [m, m, rad]. covariance: of the estimate, of ξ = log(mean⁻¹ · truth),
    or None. has_heading: False where either of the two knows positions only.
    """

    clock: Float[np.ndarray, " n"]
    estimate: Float[np.ndarray, "n 3"]
    truth: Float[np.ndarray, "n 3"]
    covariance: Float[np.ndarray, "n 3 3"] | None = None
    has_heading: bool = True

    def __post_init__(self) -> None:
        for name in ("clock", "estimate", "truth", "covariance"):
            value = getattr(self, name)
            if value is not None:
                array = np.array(value, dtype=float)
                array.flags.writeable = False
                object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.clock)


def rigid_alignment(source: Float[np.ndarray, "n 2"], target: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3"]:
    """Return the rigid motion [m, m, rad] that carries the source nearest to the target, in the sense of least squares.

    In the plane the best rotation is the argument of Σ conj(s) t, s and t the centred points as complex numbers; that
    of Umeyama (1991) without scale. A single point, or points that coincide, give a translation; none the identity.
    """
    if len(source) == 0:
        return np.zeros(3)
    centre, goal = source.mean(axis=0), target.mean(axis=0)
    s, t = source - centre, target - goal
    angle = np.arctan2(np.sum(s[:, 0] * t[:, 1] - s[:, 1] * t[:, 0]), np.sum(s * t))
    shift = goal - se2.transform(np.array([0.0, 0.0, angle]), centre[None])[0]
    return np.array([*shift, angle])


def align_pairs(pairs: Pairs, align: Align = "rigid") -> tuple[Pairs, Float[np.ndarray, "3"]]:
    """Carry the estimate to the truth; return the pairs, and the motion [m, m, rad] applied from the left.

    rigid: least squares over all positions. first: onto the first pose. none: both share a frame already.

    Raises:
        LongreachError: `first`, and the heading of the truth or of the estimate is not known.
    """
    if align == "none" or len(pairs) == 0:
        return pairs, np.zeros(3)
    if align == "rigid":
        motion = rigid_alignment(pairs.estimate[:, :2], pairs.truth[:, :2])
    else:
        need_heading(pairs, "align first poses")
        motion = se2.compose(pairs.truth[0], se2.inverse(pairs.estimate[0]))
    return replace(pairs, estimate=se2.compose(motion, pairs.estimate)), motion


def moved(trajectory: PoseTrajectory, motion: Float[np.ndarray, "3"]) -> PoseTrajectory:
    """Return the trajectory seen from another frame: motion · pose; its covariance, in the body frame, stays."""
    return replace(trajectory, poses=se2.compose(motion, trajectory.poses))


def need_heading(pairs: Pairs, purpose: str) -> None:
    """Raise LongreachError unless both headings are known."""
    if not pairs.has_heading:
        raise LongreachError(f"Headings must be known to {purpose}; the reference has positions only.")


def associate(estimate: PoseTrajectory, truth: PoseTrajectory, longest_gap: float = LONGEST_GAP) -> Pairs:
    """Pair the two at the rows of the sparser one, with the denser one interpolated on SE(2).

    Rows meet by their stamps as recorded, so that a reference made from a log whose stamps run backwards still finds
    its rows. `Pairs.clock` is the estimate's. A covariance is that of the nearest row of the estimate.

    Arguments: longest_gap [s] between two rows of the denser one that interpolation may bridge.

    Raises:
        LongreachError: the two have no instant in common.
    """
    _check_overlap(estimate, truth)
    low, high = max(estimate.clock[0], truth.clock[0]), min(estimate.clock[-1], truth.clock[-1])
    rows = [np.count_nonzero((t.clock >= low) & (t.clock <= high)) for t in (estimate, truth)]
    makers = (_at_truth_rows, _at_estimate_rows) if rows[1] <= rows[0] else (_at_estimate_rows, _at_truth_rows)
    for make in makers:
        pairs = make(estimate, truth, longest_gap)
        if len(pairs) > 0:
            return pairs
    raise LongreachError(
        f"Neither the estimate nor the truth has rows less than {longest_gap:g} s apart where the other has one; "
        "allow a longer gap."
    )


def _check_overlap(estimate: PoseTrajectory, truth: PoseTrajectory) -> None:
    for name, trajectory in (("estimate", estimate), ("truth", truth)):
        if len(trajectory) == 0:
            raise LongreachError(f"The {name} has no rows to compare.")
    if estimate.clock[0] > truth.clock[-1] or truth.clock[0] > estimate.clock[-1]:
        raise LongreachError(
            f"The estimate, {estimate.clock[0]:.3f} to {estimate.clock[-1]:.3f} s, and the truth, "
            f"{truth.clock[0]:.3f} to {truth.clock[-1]:.3f} s, have no time in common; give both on one clock."
        )


def _at_truth_rows(estimate: PoseTrajectory, truth: PoseTrajectory, longest_gap: float) -> Pairs:
    clock = estimate.clock_at(truth.stamps)
    poses, known = estimate.at(clock, longest_gap)
    rows = np.flatnonzero(known)
    rows = rows[np.argsort(clock[rows], kind="stable")]
    covariance = None if estimate.covariance is None else estimate.covariance[_nearest(estimate.clock, clock[rows])]
    return Pairs(clock[rows], poses[rows], truth.poses[rows], covariance, estimate.has_heading and truth.has_heading)


def _at_estimate_rows(estimate: PoseTrajectory, truth: PoseTrajectory, longest_gap: float) -> Pairs:
    poses, known = truth.at(truth.clock_at(estimate.stamps), longest_gap)
    covariance = None if estimate.covariance is None else estimate.covariance[known]
    has_heading = estimate.has_heading and truth.has_heading
    return Pairs(estimate.clock[known], estimate.poses[known], poses[known], covariance, has_heading)


def _nearest(known: np.ndarray, clock: np.ndarray) -> np.ndarray:
    right = np.clip(np.searchsorted(known, clock), 0, len(known) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(clock - known[left] <= known[right] - clock, left, right)
