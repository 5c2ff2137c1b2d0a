"""One step of a hierarchy of tasks given as matrices: (4.16) for any number of levels, or (4.17)."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from longreach.errors import PlanningError
from longreach.planning import _priority_kernels as kernels
from longreach.planning._pseudoinverse_kernels import DAMPED, SELECTIVE, UNDAMPED
from longreach.planning.pseudoinverse import Inverse

Scheme = Literal["siciliano-slotine", "chiaverini"]
SCHEMES = {"siciliano-slotine": kernels.SICILIANO_SLOTINE, "chiaverini": kernels.CHIAVERINI}
METHODS = {"undamped": UNDAMPED, "damped": DAMPED, "selective": SELECTIVE}


def level_settings(
    inverses: Sequence[Inverse], prismatic: Bool[np.ndarray, " n"], widest: int
) -> tuple[Float[np.ndarray, "levels 5"], Float[np.ndarray, "levels n"], Float[np.ndarray, "levels blocks"]]:
    """Return the inverses of all levels as the kernels take them: settings, and bounds where selective."""
    filters = [(0.0, 0.0) if c.filter is None else (c.filter.sigma0, c.filter.v) for c in inverses]
    setting = [[METHODS[c.method], c.damping, c.rank_tolerance, *f] for c, f in zip(inverses, filters, strict=True)]
    reach = np.array([c.max_step(prismatic) for c in inverses])
    return np.array(setting, dtype=float), reach, np.array([c.max_error(widest) for c in inverses])


def hierarchy_step(
    jacobians: Sequence[Float[np.ndarray, "_ n"]],
    wanted: Sequence[Float[np.ndarray, " _"]],
    z: Float[np.ndarray, " n"] | None = None,
    scheme: Scheme = "siciliano-slotine",
    inverse: Inverse | None = None,
) -> Float[np.ndarray, " n"]:
    """Return q̇ (n,) that gives each level what it wants as far as the levels before it leave room.

    Arguments: jacobians (m, n) and wanted (m,) = -λ e of each level, the most important first; z of (4.15); inverse: J#
        of all levels, undamped where not given.

    Raises:
        PlanningError: there are no levels, or lengths that do not fit.
    """
    inverse = inverse or Inverse(method="undamped")
    if not jacobians or len(jacobians) != len(wanted):
        raise PlanningError("A hierarchy needs at least one level, and for each a Jacobian and what it wants.")
    if any(len(J) != len(a) for J, a in zip(jacobians, wanted, strict=True)):
        raise PlanningError("Each level must want as many numbers as its Jacobian has rows.")
    A, a = np.vstack(jacobians).astype(float), np.concatenate(wanted).astype(float)
    (M, n), levels = A.shape, len(jacobians)
    free = np.zeros(n) if z is None else np.array(z, dtype=float)
    if len(free) != n or not (np.all(np.isfinite(A)) and np.all(np.isfinite(a)) and np.all(np.isfinite(free))):
        raise PlanningError(f"The Jacobians, what they want and z must be finite, and z have {n} numbers.")
    starts = np.cumsum([0, *(len(J) for J in jacobians)])
    setting, reach, longest = level_settings([inverse] * levels, np.zeros(n, dtype=bool), int(np.diff(starts).max()))
    no, zero, wide = np.zeros(M, dtype=bool), np.zeros(M), np.full((2, n), np.inf)
    dq = np.empty(n)
    kernels.step(
        A, a, starts, no, no.copy(), zero, zero, zero, SCHEMES[scheme], setting, reach, longest, free, -wide, wide,
        np.zeros(M, dtype=np.int64), kernels.workspace(M, n), np.empty(levels + 1), dq,
    )  # fmt: skip
    return dq
