"""Where a run of Algorithm 2 stands, and how it is to go on."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import BaseModel, ConfigDict, Field

from longreach.planning.program import Program
from longreach.planning.sequence import Sequence
from longreach.planning.subproblem import Difference


class SqpConfig(BaseModel):
    """How Algorithm 2 goes on; most defaults are TrajOpt's (Schulman 2013)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    accept: float = Field(default=0.25, ge=0, lt=1)  # c, the least TrueImprove/ModelImprove of a step that is taken
    shrink: float = Field(default=0.5, gt=0, lt=1)  # τ⁻, of the trust region after a step that is not; TrajOpt's is 0.1
    expand: float = Field(default=1.5, ge=1)  # τ⁺, of the trust region after a step that is
    trust: float = Field(default=0.1, gt=0)  # δ [rad, m] at first: the farthest one joint goes in one iteration
    least_trust: float = Field(default=1e-8, gt=0)  # δ below which nothing more is to be had; TrajOpt's is 1e-4
    most_trust: float = Field(default=0.5, gt=0)  # δ at most
    penalty: float = Field(default=10.0, gt=0)  # μ of each constraint at first
    raise_by: float = Field(default=10.0, gt=1)  # k, of the penalties of constraints that are still violated
    raises: int = Field(default=5, ge=0)  # how often at most
    stalled: float = Field(
        default=1e-4, gt=0
    )  # part of the merit: with less to gain, violated constraints stay so at this μ
    curvature_floor: float = Field(default=1e-3, gt=0)  # the least curvature of a subproblem, so that it is convex
    iterations: int = Field(default=60, ge=1)  # at most, of all penalties together
    stationary: float = Field(default=5e-7, gt=0)  # the KKT residual of an answer called solved
    feasible: float = Field(default=1e-8, gt=0)  # its largest violation [m, rad, or the constraint's unit]
    met: float = Field(default=1e-6, gt=0)  # violations up to this are none: what an answer is reported by
    budget: float = Field(default=float("inf"), gt=0)  # [s]; then the best that was found counts


@dataclass(eq=False)
class Run:
    """Where B problems of N waypoints stand: configurations x (B, N, n) with all that is known of them.

    f, g, c, A: the terms' values and derivatives, (B, N, ...). trust (B,): δ; mu (B, m), mu_links (l,): penalties; lam
    (B, N, m), lam_limits (B, N, n), lam_links: multipliers; H (B, N, p, p): curvature in the free directions.
    """

    program: Program
    config: SqpConfig
    x: Float[np.ndarray, "B N n"]
    f: Float[np.ndarray, "B N"]
    g: Float[np.ndarray, "B N n"]
    c: Float[np.ndarray, "B N m"]
    A: Float[np.ndarray, "B N m n"]
    trust: Float[np.ndarray, " B"]
    mu: Float[np.ndarray, "B m"]
    mu_links: Float[np.ndarray, " l"]
    lam: Float[np.ndarray, "B N m"]
    lam_limits: Float[np.ndarray, "B N n"]
    lam_links: list[np.ndarray]
    H: Float[np.ndarray, "B N p p"]
    kkt: Float[np.ndarray, " B"]
    fresh: Bool[np.ndarray, " B"]
    done: Bool[np.ndarray, " B"]
    solved: Bool[np.ndarray, " B"]
    raised: Int[np.ndarray, " B"]
    best: Float[np.ndarray, " B"]
    best_x: Float[np.ndarray, "B N n"]
    sequence: Sequence = field(default_factory=Sequence)
    history: list[dict[str, float]] = field(default_factory=list)
    held: tuple[Difference, ...] = ()
    late: bool = False


def start(program: Program, x0: Float[np.ndarray, "B N n"], config: SqpConfig) -> Run:
    """Return the run's beginning; what lies outside the limits is put on them."""
    x = np.clip(x0, program.lower, program.upper)
    B, N, n = x.shape
    m = program.layout.lower.shape[1]
    p = max(n - int(program.layout.equation.sum()), 0)
    e = program.evaluate(x, np.arange(B))
    no = np.zeros(B, dtype=bool)
    return Run(
        program=program, config=config, x=x,
        f=e.f.reshape(B, N), g=e.g.reshape(B, N, n), c=e.c.reshape(B, N, m), A=e.A.reshape(B, N, m, n),
        trust=np.full(B, config.trust),
        mu=np.full((B, m), config.penalty), mu_links=np.full(len(program.limits), config.penalty),
        lam=np.zeros((B, N, m)), lam_limits=np.zeros((B, N, n)),
        lam_links=[np.zeros(limit.lower.shape) for limit in program.limits],
        H=np.zeros((B, N, p, p)), kkt=np.full(B, np.inf),
        fresh=~no, done=no.copy(), solved=no.copy(), raised=np.zeros(B, dtype=int),
        best=np.full(B, np.inf), best_x=x.copy(),
    )  # fmt: skip
