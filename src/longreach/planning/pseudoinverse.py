"""Inverses of a Jacobian: undamped, damped and selectively damped, with singular value filtering before any of them.

Which to choose (measured over 300 poses of a nine-joint chain): error-proportional damping converges fastest; selective
damping bounds every step, at two to three times the iterations; filtering alone bounds nothing. So: selective for
trajectories and tasks of lower priority, damped for one pose, undamped where a projector must be exact.

The projector is always I - J⁺ J of the undamped, rank-truncated pseudoinverse: with J# of (4.7) in its place, as (4.15)
is written, it is no projector, and z disturbs the task.

Source: (4.6)–(4.15); Chan & Lawrence 1988 (damped); Buss & Kim 2005, "Selectively damped least squares for inverse
kinematics"; Colomé & Torras 2015 (filtering).
"""

import math
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float
from pydantic import BaseModel, ConfigDict, Field, model_validator

from longreach.errors import PlanningError
from longreach.planning import _pseudoinverse_kernels as _kernels

# Singular values below this part of the largest count as zero. Forward kinematics leaves 1e-16 of it where a direction
# is lost; what is cut off is as much as a projector lets through.
RANK_TOLERANCE = 1e-12

_Bound = Annotated[float, Field(gt=0)]  # infinity: no bound
_Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_METHODS = {"undamped": _kernels.UNDAMPED, "damped": _kernels.DAMPED, "selective": _kernels.SELECTIVE}


class SingularValueFilter(BaseModel):
    """Settings of (4.12): how far small singular values are lifted."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    sigma0: _Weight = Field(default=1e-3, description="What a singular value of 0 becomes [1]; Colomé & Torras.")
    v: _Weight = Field(default=20.0, description="Shape factor, larger: others stay nearer to themselves [1].")

    @model_validator(mode="after")
    def _monotone(self) -> "SingularValueFilter":
        if self.v * self.sigma0 > 2.0:
            raise ValueError("v times sigma0 must be at most 2, or a larger singular value would become a smaller one")
        return self


class Inverse(BaseModel):
    """How a task's error becomes a step of the joints: the choice of J# in (4.15)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: Literal["undamped", "damped", "selective"] = Field(
        default="selective", description="(4.6) truncated at the rank, (4.7), or (4.11) after Buss & Kim."
    )
    damping: _Weight = Field(default=0.0, description="λ of (4.7), where damped [1].")
    error_damping: _Weight = Field(
        default=0.05, description="Where damped, this times ‖e‖² is added to λ [1]; the fastest of those tried."
    )
    filter: SingularValueFilter | None = Field(default=None, description="Singular value filtering (4.12) before it.")
    rank_tolerance: float = Field(
        default=RANK_TOLERANCE, ge=0, lt=1, description="Part of the largest singular value that counts as 0 [1]; ours."
    )
    max_step_revolute: _Bound = Field(
        default=math.pi / 4, description="γ_max, the longest step where selective [rad]; Buss & Kim."
    )
    max_step_prismatic: _Bound = Field(default=0.2, description="γ_max of a prismatic joint [m]; ours.")
    max_error_linear: _Bound = Field(
        default=0.3, description="Where selective, the longest error of position at once [m]; half a link of the UR10."
    )
    max_error_angular: _Bound = Field(
        default=math.pi / 4, description="Where selective, the largest error of orientation at once [rad]; ours."
    )

    def max_step(self, prismatic: Bool[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return γ_max of each joint (n,) [rad, or m where prismatic]."""
        return np.where(prismatic, self.max_step_prismatic, self.max_step_revolute)

    def max_error(self, rows: int) -> Float[np.ndarray, " blocks"]:
        """Return the clamp of each block of 3 rows, linear and angular by turns as in [v; ω]."""
        blocks = -(-rows // 3)
        return np.resize([self.max_error_linear, self.max_error_angular], blocks)

    def step(
        self,
        J: Float[np.ndarray, "m n"],
        e: Float[np.ndarray, " m"],
        prismatic: Bool[np.ndarray, " n"] | None = None,
    ) -> Float[np.ndarray, " n"]:
        """Return J# e (n,), the step whose task-space part is e (the solver puts its -λ before e).

        Arguments: prismatic (n,): which joints are bounded in metres; none where not given.
        """
        J, A, s, _ = _decomposed(J, self.rank_tolerance)
        e = _vector(e, len(J), "error")
        if self.filter is not None:
            _kernels.filter_values(s, self.filter.v, self.filter.sigma0)
        selective = self.method == "selective"
        if selective:
            _kernels.clamp_blocks(e.copy(), self.max_error(len(J)), e)
        damping = self.damping + self.error_damping * float(e @ e) if self.method == "damped" else 0.0
        n = J.shape[1]
        bound = self.max_step(np.zeros(n, dtype=bool) if prismatic is None else prismatic)
        out = np.empty(n)
        _kernels.step(J, A, s, e, _METHODS[self.method], damping, bound, np.empty(n), out)
        return out


def _matrix(J: np.ndarray) -> np.ndarray:
    J = np.ascontiguousarray(J, dtype=float)
    if J.size == 0 or not np.all(np.isfinite(J)):
        raise PlanningError(f"A Jacobian of shape {J.shape} must have finite numbers in it to be inverted.")
    return J


def _vector(value: np.ndarray, size: int, what: str) -> np.ndarray:
    vector = np.array(value, dtype=float)
    if len(vector) != size or not np.all(np.isfinite(vector)):
        raise PlanningError(f"The {what} must be {size} finite numbers, as the Jacobian has it.")
    return vector


def _decomposed(J: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Return J, its rows [v_iᵀ | u_iᵀ], its singular values and its rank."""
    J = _matrix(J)
    m, n = J.shape
    A, s = np.empty((m, n + m)), np.empty(m)
    rank = _kernels.decompose(J, tolerance, A, s)
    return J, A, s, rank


def singular_values(
    J: Float[np.ndarray, "m n"],
) -> tuple[Float[np.ndarray, "m m"], Float[np.ndarray, " m"], Float[np.ndarray, "m n"]]:
    """Return U, σ (descending) and V with J = U · diag(σ) · V; rows of V are v_iᵀ (4.8)."""
    J, A, s, _ = _decomposed(J, 1e-14)  # what is below is rounding, and so is its direction
    return A[:, J.shape[1] :].T.copy(), s, A[:, : J.shape[1]].copy()


def pseudoinverse(J: Float[np.ndarray, "m n"], rank_tolerance: float = RANK_TOLERANCE) -> Float[np.ndarray, "n m"]:
    """Return J⁺ = Σ σ_i⁻¹ v_i u_iᵀ (4.9) over the σ_i above `rank_tolerance` times the largest.

    Without the truncation, as in (4.6), it does not exist where a row depends on the others.
    """
    return _inverse_matrix(J, 0.0, rank_tolerance)


def damped_pseudoinverse(J: Float[np.ndarray, "m n"], damping: float) -> Float[np.ndarray, "n m"]:
    """Return Jᵀ (J Jᵀ + λ I)⁻¹ (4.7), `damping` being λ; 0 gives the pseudoinverse."""
    if not (math.isfinite(damping) and damping >= 0.0):
        raise PlanningError(f"The damping is {damping}; it must be zero or a positive number.")
    return _inverse_matrix(J, damping, RANK_TOLERANCE)


def _inverse_matrix(J: np.ndarray, damping: float, tolerance: float) -> np.ndarray:
    J, A, s, _ = _decomposed(J, tolerance)
    out = np.empty(J.shape[::-1])
    _kernels.inverse_matrix(A, s, damping, out)
    return out


def filter_singular_values(
    J: Float[np.ndarray, "m n"], v: float = 20.0, sigma0: float = 1e-3
) -> Float[np.ndarray, "m n"]:
    """Return Ĵ = Σ h(σ_i) u_i v_iᵀ (4.13), h(σ) = σ + 2σ0 / (σ² + vσ + 2) (4.12).

    h lifts every singular value, not only the lowest as the thesis has it; h(0) = σ0, h → σ for large ones, and it is
    monotone only if v·σ0 ≤ 2. Where σ_i = 0, any direction of the null space serves as v_i.
    """
    J, A, s, _ = _decomposed(J, RANK_TOLERANCE)
    _kernels.filter_values(s, v, sigma0)
    out = np.empty_like(J)
    _kernels.reassemble(A, s, out)
    return out


def null_space_projector(
    J: Float[np.ndarray, "m n"], rank_tolerance: float = RANK_TOLERANCE
) -> Float[np.ndarray, "n n"]:
    """Return N = I - J⁺ J, symmetric, N N = N and J N = 0, also where J has lost rank."""
    J, A, _, rank = _decomposed(J, rank_tolerance)
    out = np.empty((J.shape[1], J.shape[1]))
    _kernels.null_projector(A, rank, out)
    return out


def selectively_damped_step(
    J: Float[np.ndarray, "m n"],
    e: Float[np.ndarray, " m"],
    max_step: Float[np.ndarray, " n"],
    max_error: Float[np.ndarray, " blocks"] | None = None,
) -> Float[np.ndarray, " n"]:
    """Return the step (n,) of Buss & Kim for the task error e: no joint moves further than its `max_step`.

    A direction u_i of the task is held back where the joints would have to move its blocks (3 rows each, the last may
    have fewer) much further than it goes, which is so near a singularity. It depends on the error through its clamps,
    so that (4.11) with a λ_i for each singular value does not describe it.
    Ours differs in one thing: γ_max is one number for each joint, because metres and radians do not compare.

    Arguments: max_step: γ_max (n,) [rad, or m]; max_error: the longest e of each block [m, or rad], no bound without.
    """
    J, A, s, _ = _decomposed(J, RANK_TOLERANCE)
    e = _vector(e, len(J), "error")
    bound = np.asarray(max_step, dtype=float)
    if not np.all(bound > 0):
        raise PlanningError("Every joint's max_step must be positive.")
    if max_error is not None:
        _kernels.clamp_blocks(e.copy(), max_error, e)
    out = np.empty(J.shape[1])
    _kernels.selective_step(J, A, s, e, bound, np.empty_like(out), out)
    return out


def general_solution(
    J: Float[np.ndarray, "m n"],
    a: Float[np.ndarray, " m"],
    z: Float[np.ndarray, " n"],
    inverse: Inverse | None = None,
    prismatic: Bool[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, " n"]:
    """Return q̇ = J# a + (I - J⁺ J) z (4.15), for any z (n,); J# as `inverse` says."""
    inverse = inverse or Inverse()
    N = null_space_projector(J, inverse.rank_tolerance)
    return inverse.step(J, a, prismatic) + N @ _vector(z, len(N), "vector z")
