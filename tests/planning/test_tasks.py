"""Tasks: every Jacobian is the derivative of its value, targets are checked, values mean what they say."""

import inspect

import numpy as np
import pytest
from jacobians import assert_is_jacobian

from longreach.errors import PlanningError
from longreach.geometry import se3, so3
from longreach.io.robots import load_robot
from longreach.planning import task, tasks_pose, tasks_range
from longreach.planning.obstacles import Box, Capsule, Disc, LinkCapsule, link_capsules
from longreach.planning.task import Task, levels_of
from longreach.planning.tasks_pose import (
    BaseHeading,
    BasePose,
    BasePosition,
    Posture,
    ToolOrientation,
    ToolPose,
    ToolPosition,
)
from longreach.planning.tasks_range import (
    ArmClearance,
    BaseClearance,
    FieldOfView,
    LookAt,
    Manipulability,
    WithinLimits,
)

THING = load_robot("thing")
HOME = np.array([0.0, 0.0, 0.0, 0.0, -2.0, 2.0, -1.5, -1.57, 0.0])
OBSTACLES = (
    Disc(np.array([1.5, -0.8]), 0.2),
    Box(se3.from_rotation_translation(so3.exp(np.array([0.2, 0.1, 0.7])), np.array([-1.0, 1.5, 0.5])), np.ones(3)),
    Capsule(np.array([2.0, 1.0, 0.3]), np.array([2.0, 2.0, 1.5]), 0.1),
)
LINKS = (LinkCapsule("forearm_link", Capsule(np.zeros(3), np.array([0.5, 0.0, 0.0]), 0.06)),)
T = se3.exp(np.array([0.3, -0.4, 0.9, 0.5, -0.8, 1.1]))
TASKS = [
    ToolPose(T),
    ToolPose(T, frame="realsense", name="camera pose"),
    ToolPosition(T[:3, 3]),
    ToolOrientation(T[:3, :3]),
    BasePose(np.array([0.4, -0.3, 0.8])),
    BasePosition(np.array([0.4, -0.3])),
    BaseHeading(0.7),
    Posture(HOME),
    WithinLimits(),
    BaseClearance(OBSTACLES, radius=0.6),
    ArmClearance(OBSTACLES, LINKS),
    LookAt(np.array([2.0, 0.5, 0.7])),
    LookAt(np.array([2.0, 0.5, 0.7]), frame="realsense", name="camera looks at"),
    FieldOfView(np.array([2.0, 0.5, 0.7]), half_angle=0.3),
    Manipulability(),
]


def kinds_of_task():
    found = set()
    for module in (task, tasks_pose, tasks_range):
        for _, member in inspect.getmembers(module, inspect.isclass):
            if issubclass(member, Task) and not member.__name__.startswith("_") and not inspect.isabstract(member):
                found.add(member)
    return found


def near_home(rng, spread=0.4):
    return HOME + spread * rng.normal(size=9)


def test_every_kind_of_task_has_its_jacobian_checked_here():
    assert kinds_of_task() == {type(t) for t in TASKS}


@pytest.mark.parametrize("checked", TASKS, ids=lambda t: t.name)
def test_the_jacobian_is_the_derivative_of_the_value(checked, rng):
    for _ in range(5):
        q = near_home(rng)
        value, J = checked.value_and_jacobian(THING, q)
        assert J.shape == (len(value), 9)
        assert len(value) == len(checked.angular(THING)) == len(checked.bounds(THING)[0])
        assert_is_jacobian(lambda x: checked.value(THING, x), J, q, atol=2e-6)


def test_errors_are_nothing_at_their_targets(rng):
    q = near_home(rng)
    T = THING.forward(q)
    for met in (
        ToolPose(T),
        ToolPosition(T[:3, 3]),
        ToolOrientation(T[:3, :3]),
        BasePose(q[:3]),
        BasePosition(q[:2]),
        BaseHeading(float(q[2])),
        Posture(q),
        LookAt(T[:3, 3] + 0.7 * T[:3, 2]),
    ):
        np.testing.assert_allclose(met.error(THING, q), 0.0, atol=1e-12)


def test_the_error_of_a_range_is_how_far_out_it_is():
    q = HOME.copy()
    q[4] = THING.upper[4] + 0.25
    expected = np.zeros(9)
    expected[4] = 0.25
    np.testing.assert_allclose(WithinLimits().error(THING, q), expected, atol=1e-12)


def test_a_weight_of_zero_frees_a_row(rng):
    free = ToolPose(T, weights=(1.0, 1.0, 1.0, 1.0, 1.0, 0.0))
    assert free.error(THING, near_home(rng))[5] == 0.0


def test_looking_at_a_point_is_turning_the_axis_onto_it(rng):
    q = near_home(rng)
    looks = LookAt(np.array([2.0, 0.5, 0.7]))
    e, T = looks.value(THING, q), THING.forward(q)
    turned = T[:3, :3] @ so3.exp(np.array([-e[0], -e[1], 0.0]))
    direction = looks.target - T[:3, 3]
    np.testing.assert_allclose(turned[:, 2], direction / np.linalg.norm(direction), atol=1e-12)
    np.testing.assert_allclose(FieldOfView(looks.target, 1.0).value(THING, q), np.linalg.norm(e), atol=1e-12)


def test_the_urdf_gives_capsules_for_the_arm_and_none_for_the_base():
    names = {link.frame for link in link_capsules(THING)}
    assert {"upper_arm_link", "forearm_link"} <= names
    assert "base_link" not in names


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: ToolPose(np.diag([1.0, 1.0, 2.0, 1.0])), "no rigid motion"),
        (lambda: ToolPose(np.full((4, 4), np.nan)), "must be finite"),
        (lambda: ToolOrientation(np.diag([1.0, 1.0, -1.0])), "no rigid motion"),
        (lambda: BaseHeading(np.nan), "must be finite"),
        (lambda: Posture(np.zeros(4)).value(THING, HOME), "has 4 numbers, but thing has 9"),
        (lambda: BasePose(np.zeros(3)).value(load_robot("ur10"), np.zeros(6)), "has no base"),
        (lambda: BasePose(np.zeros(3), gain=0.0), "gain .* above 0"),
        (lambda: BasePose(np.zeros(3), weights=(1.0, -1.0, 1.0)), "weights .* not negative"),
        (lambda: BasePose(np.zeros(3), weights=(1.0,)).weighed(THING), "3 rows, but 1 weights"),
        (lambda: FieldOfView(np.zeros(3), 4.0), "between 0 and π"),
        (lambda: levels_of([]), "no tasks"),
        (lambda: levels_of([BaseHeading(0.0), [BaseHeading(1.0)]]), "Two tasks are called 'base heading'"),
        (lambda: Disc(np.zeros(2), -1.0), "radius"),
        (lambda: Box(np.eye(4), np.zeros(3)), "three positive numbers"),
        (lambda: Box(2.0 * np.eye(4), np.ones(3)), "no rigid motion"),
    ],
)
def test_what_cannot_be_a_task_is_refused_with_a_sentence(wrong, message):
    with pytest.raises(PlanningError, match=message):
        wrong()
