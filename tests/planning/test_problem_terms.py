"""Every cost and constraint: values where they are known, and derivatives by finite differences, none left out."""

import importlib
import pkgutil

import numpy as np
import pytest
from jacobians import assert_is_jacobian

import longreach as lr
import longreach.planning
from longreach.errors import PlanningError
from longreach.planning import terms, terms_clearance, terms_pose
from longreach.planning.obstacles import Box, Capsule, Disc, LinkCapsule, link_capsules
from longreach.planning.problem import Problem, evaluate
from longreach.planning.tasks_range import BaseClearance, FieldOfView
from longreach.planning.terms import Constraint, Cost, Waypoints
from longreach.robot.manipulability import manipulability

THING = lr.load_robot("thing")
Q = np.array([0.3, -0.2, 0.4, 0.3, -1.9, 1.8, -1.4, -1.5, 0.2])
REFERENCE = lr.Reference(
    np.arange(2.0), tool=np.stack([THING.forward(Q + 0.2), THING.forward(Q)]), base=np.array([[0.1, 0.2, 3.1], Q[:3]])
)
TURNED = np.array([[0.6, -0.8, 0, 1.5], [0.8, 0.6, 0, 0.4], [0, 0, 1, 1.0], [0, 0, 0, 1]])
OBSTACLES = (
    Disc(np.array([2.0, 1.0]), 0.3),
    Box(TURNED, np.array([0.4, 0.5, 0.9])),
    Capsule(np.array([0.5, -2.0, 0.3]), np.array([0.9, -1.5, 1.5]), 0.1),
)
CAPSULE = LinkCapsule("tool", Capsule(np.array([0, 0, -0.3]), np.array([0, 0.05, 0.1]), 0.06))
DECK = Box(np.eye(4), np.array([0.96, 0.79, 0.6]))
CASES = [
    *(terms.Manipulability(name, part) for name in terms.Manipulability._MEASURES for part in ("full", "arm")),
    terms.NearSeed(0.1 * Q[None], np.arange(9.0)),
    terms_pose.ToolPose(),
    terms_pose.BaseDisc(0.2),
    terms_pose.BaseHeading(0.1),
    terms_pose.TaskConstraint(BaseClearance(OBSTACLES, 0.6)),
    terms_pose.TaskConstraint(FieldOfView(np.array([3.0, 1.0, 0.5]), 0.4)),
    terms_clearance.base_clearance(0.6, OBSTACLES),
    terms_clearance.Clearance((CAPSULE,), OBSTACLES, points=np.array([[1.0, 2.0, 0.3], [0.0, 0.9, 1.2]])),
    terms_clearance.SelfClearance((CAPSULE,), (DECK,)),
]


def at(q, index=0):
    q = np.atleast_2d(q)
    return Waypoints(THING, REFERENCE, np.full(len(q), index), q)


def value_and_derivative(term, q):
    if isinstance(term, Cost):
        value, gradient = term.value_and_gradient(at(q))
        return value, gradient
    value, jacobian = term.value_and_jacobian(at(q))
    return value[0], jacobian[0]


@pytest.mark.parametrize("term", CASES, ids=lambda term: f"{type(term).__name__}-{term.name}")
def test_the_derivative_of_every_term_is_that_of_its_value(term):
    _, J = value_and_derivative(term, Q)
    assert_is_jacobian(lambda q: value_and_derivative(term, q)[0], J, Q, atol=2e-6)


@pytest.mark.parametrize("term", CASES, ids=lambda term: f"{type(term).__name__}-{term.name}")
def test_the_curvature_of_every_term_is_the_derivative_of_its_gradient_or_none(term, rng):
    Z = np.eye(9)[None]
    if isinstance(term, Cost):
        H = term.curvature(at(Q), Z)[0]

        def gradient(q):
            return term.value_and_gradient(at(q))[1][0]
    else:
        v, _ = term.value_and_jacobian(at(Q))
        y = rng.normal(size=v.shape)
        if isinstance(term, terms_pose.BaseDisc):
            y[:, 1:] = 0.0  # its polygon only says where the disc is
        H = term.curvature(at(Q), y, Z)[0]

        def gradient(q):
            return y[0] @ term.value_and_jacobian(at(q))[1][0]

        if not H.any() and not isinstance(term, terms_pose.BaseHeading):
            pytest.skip("its curvature is of no use to the planner")
    assert_is_jacobian(gradient, H, Q, atol=2e-4 * max(1.0, np.abs(H).max()))


def test_curvature_without_a_rule_of_its_own_is_differenced(rng):
    for term in (terms.Manipulability(), terms_pose.ToolPose()):
        Z = rng.normal(size=(2, 9, 3))
        both = at(np.stack([Q, Q + 0.1]))
        y = () if isinstance(term, Cost) else (rng.normal(size=(2, 6)),)
        kind = Cost if isinstance(term, Cost) else Constraint
        np.testing.assert_allclose(kind.curvature(term, both, *y, Z), term.curvature(both, *y, Z), rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("part", ["full", "arm"])
@pytest.mark.parametrize("objective", ["sqrt_kappa_over_m", "neg_log_m", "neg_m", "kappa"])
def test_manipulability_along_a_path_is_the_robots_own(objective, part, rng):
    q = Q + np.cumsum(0.1 * rng.normal(size=(30, 9)), axis=0)
    q[7, 5] = 0.0  # the elbow straight: singular for the arm
    f, g = terms.Manipulability(objective, part).value_and_gradient(at(q))
    name = {"neg_log_m": "log_m", "neg_m": "m"}.get(objective, objective)
    value, gradient = manipulability(THING, q, name, part)
    sign = -1.0 if objective.startswith("neg") else 1.0
    np.testing.assert_allclose(f, sign * value, rtol=1e-9)
    scale = np.abs(gradient).max(axis=1, keepdims=True)
    np.testing.assert_allclose(g / scale, sign * gradient / scale, atol=1e-8)


def test_no_term_is_left_out():
    for module in pkgutil.iter_modules(longreach.planning.__path__, "longreach.planning."):
        importlib.import_module(module.name)
    known = {type(term) for term in CASES}
    assert {*Cost.__subclasses__(), *Constraint.__subclasses__()} <= known


@pytest.mark.parametrize("term", CASES, ids=lambda term: f"{type(term).__name__}-{term.name}")
def test_many_waypoints_at_once_are_each_by_itself(term, rng):
    many = Q + 0.1 * rng.normal(size=(4, 9))
    if isinstance(term, Cost):
        together = term.value_and_gradient(at(many))
    else:
        together = term.value_and_jacobian(at(many))
        lower, upper = term.bounds(at(many))
        assert lower.shape == upper.shape == together[0].shape
    for i, q in enumerate(many):
        value, derivative = value_and_derivative(term, q)
        np.testing.assert_allclose(np.atleast_2d(together[0][i]).ravel(), value, atol=1e-12)
        np.testing.assert_allclose(np.atleast_2d(together[1][i]), derivative, atol=1e-12)


def test_clearance_agrees_with_the_task_of_the_same_name():
    v, J = terms_clearance.base_clearance(0.6, OBSTACLES).value_and_jacobian(at(Q))
    task = BaseClearance(OBSTACLES, 0.6).value_and_jacobian(THING, Q)
    order = [0, 2, 1]  # what is round comes first
    np.testing.assert_allclose(v[0], task[0][order], atol=1e-9)
    np.testing.assert_allclose(J[0], task[1][order], atol=1e-9)


def test_the_robot_is_as_far_from_itself_wherever_it_stands(rng):
    term = terms_clearance.SelfClearance(link_capsules(THING), (DECK,))
    moved = Q.copy()
    moved[:3] = rng.normal(size=3)
    np.testing.assert_allclose(term.value_and_jacobian(at(moved))[0], term.value_and_jacobian(at(Q))[0], atol=1e-9)
    assert np.abs(term.value_and_jacobian(at(Q))[1][:, :, :3]).max() < 1e-12


def test_the_disc_is_exact_and_within_its_polygon(rng):
    term = terms_pose.BaseDisc(0.2)
    turn = rng.uniform(0, 2 * np.pi, 50)
    q = np.tile(Q, (50, 1))
    for radius, inside in ((0.2 - 1e-9, True), (0.2 + 1e-6, False)):
        q[:, :2] = REFERENCE.base[0, :2] + radius * np.column_stack([np.cos(turn), np.sin(turn)])
        v, _ = term.value_and_jacobian(at(q))
        lower, upper = term.bounds(at(q))
        assert np.all(np.all((lower <= v) & (v <= upper), axis=1) == inside)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: terms.NearSeed(Q[None], np.ones(9), weight=-1.0), "not below zero"),
        (lambda: terms.NearSeed(Q[None], -np.ones(9)), "joint weights"),
        (lambda: terms.NearSeed(np.full((1, 9), np.nan), np.ones(9)), "finite"),
        (lambda: terms.Manipulability("m"), "objective"),
        (lambda: terms_pose.BaseDisc(0.0), "above 0"),
        (lambda: terms_pose.BaseHeading(-0.1), "above 0"),
        (lambda: terms_clearance.Clearance((), OBSTACLES), "needs capsules"),
        (lambda: terms_clearance.Clearance((CAPSULE,), OBSTACLES, margin=-1.0), "margin"),
        (lambda: Problem(limits=False), "no terms"),
        (lambda: Problem(constraints=(terms_pose.ToolPose(), terms_pose.ToolPose())), "names of their own"),
    ],
)
def test_terms_that_cannot_be_are_refused(make, message):
    with pytest.raises(PlanningError, match=message):
        make()


def test_a_term_that_gives_no_number_is_named(monkeypatch):
    nan = np.full((1, 9), np.nan)
    monkeypatch.setattr(terms_pose.BaseDisc, "value_and_jacobian", lambda term, at: (nan, np.zeros((1, 9, 9))))
    with pytest.raises(PlanningError, match="'base disc' gave a value that is not finite"):
        evaluate(Problem(constraints=(terms_pose.BaseDisc(0.1),)), at(Q))
