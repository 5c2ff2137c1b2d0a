"""Every correction that a filter makes, and what it moved: what tests of made and of real drives share."""

from typing import NamedTuple

import numpy as np

from longreach.estimation.planar import ekf, update
from longreach.geometry import se2


class Taken(NamedTuple):
    """A correction of the local state: Δ of the relative pose, Δᵀ P⁻¹ Δ with P before it, and what it came from.

    distance: of the pose from the reference [m]. reference_moved: how far the reference's pose went, its largest
    component. whole: whether the innovation is that of a relative pose of three components.
    """

    moved: np.ndarray
    squared: float
    nis: float
    innovation: np.ndarray
    distance: float
    reference_moved: float
    whole: bool


def corrections_of(monkeypatch, run):
    """Return the corrections of the local state that a run makes, fixes left out."""
    taken, correct = [], ekf.correct

    def watched(mean, P, r, H, R, gate=np.inf, inflate=False, gain="all"):
        result = correct(mean, P, r, H, R, gate, inflate, gain)
        if gain == "local" and result.scale > 0.0:
            xi = se2.difference(mean[:3], result.mean[:3])
            scale = np.sqrt(np.maximum(np.diag(P)[:3], 1e-300))
            inverse = np.linalg.pinv(P[:3, :3] / np.outer(scale, scale), rcond=1e-13, hermitian=True)
            squared = float((xi / scale) @ inverse @ (xi / scale)) if xi.any() else 0.0
            still = np.abs(result.mean[13:16] - mean[13:16]).max()
            nis = float(result.nis)
            whole = len(r) == 3 and bool(H[:, :3].any()) and bool(H[:, ekf.CLONES :].any())
            taken.append(Taken(xi, squared, nis, r, float(np.hypot(*mean[:2])), float(still), whole))
        return result

    monkeypatch.setattr(update.ekf, "correct", watched)
    run()
    return taken
