"""Problems read from YAML are those made by hand; what is wrong in them is named."""

import numpy as np
import pytest
import yaml

import longreach as lr
from longreach.errors import ConfigError
from longreach.planning.problem import evaluate
from longreach.planning.problem_config import problem_of
from longreach.planning.terms import Waypoints

THESIS = """
costs: [{kind: manipulability}]
constraints: [{kind: tool_pose}, {kind: base_disc, radius: 0.01}, {kind: base_heading, band: 0.1}]
links: [{kind: smoothness}, {kind: step}]
"""
ALL = """
costs:
  - {kind: manipulability, objective: neg_log_m, part: arm, weight: 0.5}
  - {kind: near_seed, seed: [0.0, 0.0, 0.0], joint_weights: [1.0, 1.0, 0.1]}
constraints:
  - {kind: tool_pose}
  - {kind: field_of_view, target: [3.0, 0.0, 1.0], half_angle: 0.5}
  - kind: clearance
    base_radius: 0.62
    capsules: [{frame: tool, b: [0.0, 0.0, -0.2], radius: 0.05}]
    obstacles:
      - {shape: disc, centre: [3.0, 1.0], radius: 0.2}
      - {shape: capsule, a: [2.0, 2.0, 0.0], b: [2.0, 2.0, 1.0], radius: 0.1}
      - {shape: box, centre: [0.0, 3.0, 0.5], size: [1.0, 0.5, 1.0], turn: 0.3}
links: [{kind: smoothness, order: 2}, {kind: joint_velocity, part: 0.5}, {kind: joint_acceleration}]
limits: false
"""


def test_the_thesis_problem_can_be_written_down():
    thing = lr.load_robot("thing")
    q = np.array([[0.0, 0.0, 0.0, 0.0, -2.0, 2.0, -1.5, -1.57, 0.0]])
    at = Waypoints(thing, lr.Reference(np.zeros(1), thing.forward(q), q[:, :3]), np.zeros(1, dtype=int), q)
    read, made = problem_of(yaml.safe_load(THESIS)), lr.thesis_problem()
    for a, b in zip(vars(evaluate(read, at)).values(), vars(evaluate(made, at)).values(), strict=True):
        np.testing.assert_array_equal(a, b)
    assert [vars(link) for link in read.links] == [vars(link) for link in made.links]


def test_every_kind_of_term_can_be_chosen():
    problem = problem_of(yaml.safe_load(ALL))
    assert [term.name for term in problem.constraints] == ["tool pose", "field of view", "clearance"]
    assert len(problem.constraints[2].capsules) * len(problem.constraints[2].obstacles) == 6
    assert [link.name for link in problem.links] == ["smoothness", "joint velocity", "joint acceleration"]
    assert not problem.limits


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("constraints: [{kind: base_disc, radius: -1}]", "constraints.0.base_disc.radius"),
        ("constraints: [{kind: magic}]", "constraints.0"),
        ("costs: [{kind: manipulability, weight: -1}]", "costs.0.manipulability.weight"),
        ("costs: [{kind: manipulability, weight: .nan}]", "costs.0.manipulability.weight"),
        ("price: []", "price"),
        ("constraints: [{kind: clearance, obstacles: []}]", "obstacles"),
    ],
)
def test_what_cannot_be_is_named(text, message):
    with pytest.raises(ConfigError, match=message):
        problem_of(yaml.safe_load(text))
