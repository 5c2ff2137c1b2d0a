"""The filter's run looked back upon: what each pose is, given all that came after as well.

A Rauch–Tung–Striebel smoother in the form of Bryson and Frazier, which needs no inverse of P: that is singular where a
pose has just been cloned or made the reference. Going back over what the filter did, λ and Λ gather
what was learned later, λ ← Mᵀ λ - Hᵀ S⁻¹ r and Λ ← Mᵀ Λ M + Hᵀ S⁻¹ H; the smoothed error is -P λ, its covariance
P - P Λ P. The change of the reference is a linear map of the errors like any other. The smoother looks back over a
filter of its own, in which every measurement corrects the reference's pose too, as the theory of smoothing demands:
what that does is bounded by what the last references were wrong by.

Source: Bierman 1973, "Fixed interval smoothing with discrete measurements", the modified Bryson–Frazier smoother.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from longreach.errors import EstimationError
from longreach.estimation import replay_buffer
from longreach.estimation.planar import ekf
from longreach.estimation.planar.filter import FilterState, step
from longreach.estimation.planar.state import Event, Snapshot
from longreach.geometry import se2
from longreach.trajectory import PoseTrajectory


def smooth(state: FilterState, events: Iterable[Event]) -> PoseTrajectory:
    """Take all events, sorted as `filter.in_order` does, and return the smoothed pose at each stamp, as `run` does.

    Give `init` a config with history=0: sorted events need none.
    """
    state = replace(state, buffer=replay_buffer.init(state.newest.key, state.newest._replace(links=())))
    taken: list[Snapshot] = []
    for event in events:
        state, _ = step(state, event)
        if not taken or state.newest is not taken[-1]:
            taken.append(state.newest)
    if not taken:
        raise EstimationError("No measurement could be taken: none has a stamp at or after the start of the filter.")
    return _back(taken)


def _back(taken: Sequence[Snapshot]) -> PoseTrajectory:
    """Go back over the snapshots; of those of one stamp the last is a row."""
    n = len(taken[-1].mean)
    lam, Lam = np.zeros(n), np.zeros((n, n))
    stamps, poses, covariances = [], [], []
    for snapshot in reversed(taken):
        if not stamps or snapshot.key[0] < stamps[-1]:
            stamps.append(snapshot.key[0])
            P = snapshot.P
            J = np.zeros((3, len(P)))  # of the compounded pose's error: Ad(X⁻¹) γ + ξ
            J[:, :3], J[:, ekf.REFERENCE : ekf.CLONES] = np.eye(3), se2.adjoint(se2.inverse(snapshot.mean[:3]))
            pose, covariance = snapshot.pose
            poses.append(se2.retract(pose, -(J @ P @ lam)))
            covariance = covariance - J @ P @ Lam @ P @ J.T
            covariances.append(0.5 * (covariance + covariance.T))
        for M, H, weighed, information in reversed(snapshot.links or ()):
            lam, Lam = M.T @ lam, M.T @ Lam @ M
            if H is not None:
                lam, Lam = lam - H.T @ weighed, Lam + H.T @ information @ H
        Lam = 0.5 * (Lam + Lam.T)
    return PoseTrajectory(np.array(stamps[::-1]), np.array(poses[::-1]), np.array(covariances[::-1]))
