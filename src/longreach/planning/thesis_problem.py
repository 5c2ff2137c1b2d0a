"""Problem (4.34) of the thesis: the tool on its path, the base near its own, and the arm as nimble as may be."""

from longreach.planning.links import Smoothness, StepLimit
from longreach.planning.problem import Problem
from longreach.planning.terms import Manipulability
from longreach.planning.terms_pose import BaseDisc, BaseHeading, ToolPose
from longreach.robot.manipulability import Part

_ROOM = 1.5


def thesis_problem(
    base_radius: float = 0.01,
    heading_band: float = 0.1,
    manipulability: Part = "full",
    objective: str = "sqrt_kappa_over_m",
    smoothness: float = 6.6e-4,
    largest_step: float = 0.02,
) -> Problem:
    """Return problem (4.34), with its defaults those of section 6.3.

    Arguments: base_radius [m], heading_band [rad]: how far the base may be from its reference, exactly; manipulability:
        of the whole Jacobian (full) or the arm's own (arm); objective: sqrt_kappa_over_m (4.33), neg_log_m, neg_m or
        kappa. Between neighbouring waypoints of a whole trajectory: smoothness, the weight of their squared steps, in
        parts of the start's mean; largest_step [m, rad]: how far no joint goes at once, but at least 1.5 times as far
        as the start makes it.
    """
    return Problem(
        costs=(Manipulability(objective, manipulability),),
        constraints=(ToolPose(), BaseDisc(base_radius), BaseHeading(heading_band)),
        links=(Smoothness(smoothness, relative=True), StepLimit(largest_step, _ROOM)),
    )
