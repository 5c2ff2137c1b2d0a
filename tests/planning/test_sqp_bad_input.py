"""What cannot be planned by optimisation is refused, in one sentence that says what to mend."""

import numpy as np
import pytest

import longreach as lr
from longreach.errors import LongreachError
from longreach.planning.links import Smoothness, StepLimit, VelocityLimit
from longreach.planning.obstacles import Capsule, Disc
from longreach.planning.problem import Problem
from longreach.planning.problem_config import problem_of
from longreach.planning.terms import Manipulability
from longreach.planning.terms_clearance import arm_clearance, base_clearance

THING = lr.load_robot("thing").with_tool("flange")
HOME = np.array([0.0, 0.0, 0.0, 0.0, -2.0, 2.0, -1.5, -1.57, 0.0])
FLANGE = THING.forward(HOME)


def reference(n=3, base=0.0):
    return lr.Reference(0.1 * np.arange(n), tool=np.tile(FLANGE, (n, 1, 1)), base=np.full((n, 3), base))


def plan(method="sqp", ref=None, q0=HOME, robot=THING, **options):
    return lr.plan(robot, reference() if ref is None else ref, q0, method=method, **options)


def among(*obstacles, keep=base_clearance, what=0.62):
    return lr.thesis_problem(0.3).adding(keep(what, obstacles))


REFUSED = {
    "a base that starts inside": (
        lambda: plan(problem=among(Disc(np.array([0.1, 0.0]), 0.3))), "contains the start: base_link is",
    ),
    "an arm that starts inside": (
        lambda: plan(problem=among(Capsule(FLANGE[:3, 3], FLANGE[:3, 3], 0.2), keep=arm_clearance, what=THING)),
        "'arm clearance' contains the start",
    ),
    "limits the wrong way round": (lambda: plan(robot=THING.with_limits(np.ones(9), -np.ones(9))), "exchange them"),
    "a weight below zero": (lambda: plan(problem=Problem((Manipulability(weight=-1.0),))), "not below zero"),
    "a weight that is none": (lambda: plan(problem=Problem((Manipulability(weight=np.nan),))), "must be finite"),
    "smoothness below zero": (lambda: plan(problem=lr.thesis_problem(smoothness=-1.0)), "not below zero"),
    "a weight below zero in a file": (lambda: problem_of({"links": [{"kind": "smoothness", "weight": -1}]}), "weight"),
    "a step that is no number": (lambda: plan(problem=lr.thesis_problem(largest_step=np.nan)), "above 0"),
    "no room between limits": (
        lambda: plan(problem=lr.thesis_problem().adding(VelocityLimit(-1.0))), "limits of 'joint velocity'",
    ),
    "a reference with NaN": (lambda: plan(ref=reference(base=np.nan)), "must be finite; row 0"),
    "an empty reference": (lambda: plan(ref=reference(0)), "reference is empty"),
    "a start with NaN": (lambda: plan(q0=np.full(9, np.nan)), "9 finite numbers"),
    "an obstacle with NaN": (lambda: plan(problem=among(Disc(np.array([np.nan, 0.0]), 0.3))), "finite"),
    "an option that is none": (lambda: plan(foo=1), "no option 'foo'; they have iterations, problem"),
    "an option of the other method": (lambda: plan("task-priority", coupled=True), "no option 'coupled'"),
    "a method that is none": (lambda: plan("sqq"), "There is no method 'sqq'"),
    "a former answer of another robot": (
        lambda: plan(initial=lr.ConfigurationTrajectory(np.arange(2.0), np.zeros((2, 6)))), "joints of thing",
    ),
    "links alone": (lambda: Problem(links=(Smoothness(), StepLimit(0.1, name="smoothness"))), "names of their own"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused_in_one_sentence(case):
    make, words = REFUSED[case]
    with pytest.raises(LongreachError, match=words) as caught:
        make()
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert sentence.endswith(".")
