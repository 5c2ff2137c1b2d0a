"""longreach plan, run in this process."""

import csv
import json

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from longreach.io.robots import load_robot
from longreach.io.tum import read_spatial_tum, read_tum


@pytest.fixture(scope="module")
def thing_robot():
    return load_robot("thing")


def test_the_dual_trajectory_is_planned_and_written(run, tmp_path, thing_robot):
    answer = run("plan", "dual-trajectory", "--robot", "thing", "--waypoints", 50, "--out", tmp_path)
    assert answer.code == 0, answer.err
    with (tmp_path / "trajectory.csv").open() as file:
        header, *rows = list(csv.reader(file))
    table = np.array(rows, dtype=float)
    assert header[:4] == ["stamp", "base_x", "base_y", "base_theta"]
    assert table.shape == (50, 1 + 2 * 9)
    stamps, T = read_spatial_tum(tmp_path / "tool_reference.tum")
    np.testing.assert_allclose(thing_robot.forward(table[:, 1:10]), T, atol=1e-9)
    np.testing.assert_allclose(read_tum(tmp_path / "base_reference.tum").poses, table[:, 1:4], atol=1e-8)
    np.testing.assert_allclose(table[:, 0], stamps)
    metrics = json.loads((tmp_path / "metrics.json").read_text())["plan"]
    assert metrics["tool_unmet"] == {"value": 0, "unit": ""}
    assert {p.stem for p in (tmp_path / "figures").iterdir()} == {
        "paths", "joints", "velocities", "manipulability", "task_errors",
    }  # fmt: skip
    assert "Met everywhere: tool." in answer.out


def test_a_base_without_an_arm_is_planned_and_has_no_manipulability(run, tmp_path):
    answer = run("plan", "dual-trajectory", "--robot", "husky", "--waypoints", 20, "--out", tmp_path)
    assert answer.code == 0, answer.err
    assert "manipulability_mean" not in json.loads((tmp_path / "metrics.json").read_text())["plan"]
    assert not (tmp_path / "figures" / "manipulability.png").exists()


def test_the_mcap_holds_one_joint_trajectory(run, tmp_path):
    assert run("plan", "dual-trajectory", "--robot", "thing", "--waypoints", 20, "--out", tmp_path).code == 0
    with AnyReader([tmp_path / "trajectory.mcap"]) as bag:
        (connection,) = bag.connections
        assert connection.msgtype == "trajectory_msgs/msg/JointTrajectory"
        ((_, _, raw),) = list(bag.messages())
        message = bag.deserialize(raw, connection.msgtype)
    assert len(message.points) == 20
    assert message.joint_names[:3] == ["base_x", "base_y", "base_theta"]
    last = message.points[-1].time_from_start
    assert last.sec + 1e-9 * last.nanosec == pytest.approx(20.0)


def test_what_cannot_be_met_is_said_with_its_size(run, tmp_path):
    answer = run("plan", "dual-trajectory", "--robot", "thing", "--amplitude", 1.2, "--out", tmp_path)
    assert answer.code == 0
    assert "The base is off by" in answer.out
    assert "conflicts with tool" in answer.out


def test_a_faster_plan_keeps_the_limits(run, tmp_path):
    answer = run("plan", "dual-trajectory", "--robot", "thing", "--waypoints", 40, "--retime", "--out", tmp_path)
    assert answer.code == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["retimed"]["duration"]["value"] < metrics["plan"]["duration"]["value"]
    assert metrics["retimed"]["speed_share_max"]["value"] <= 100.1


def test_a_reference_file_is_followed(run, tmp_path):
    robot = load_robot("ur10")
    T = robot.forward(robot.home)
    lines = [f"{k * 0.1:.1f} {T[0, 3] + 0.002 * k:.9f} {T[1, 3]:.9f} {T[2, 3]:.9f} 0 0 0 1" for k in range(5)]
    (tmp_path / "line.tum").write_text("\n".join(lines))
    answer = run("plan", tmp_path / "line.tum", "--robot", "ur10", "--iterations", 200, "--out", tmp_path / "out")
    assert answer.code == 0
    assert (tmp_path / "out" / "trajectory.csv").is_file()
    assert not (tmp_path / "out" / "base_plan.tum").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nothing.tum", "--robot", "thing"], "nothing.tum is not there"),
        (["dual-trajectory", "--robot", "nobody"], "neither a robot that longreach knows"),
        (["dual-trajectory", "--robot", "thing", "--method", "magic"], "There is no method 'magic'"),
        (["dual-trajectory", "--robot", "thing", "--tool", "hand"], "hand"),
        (["dual-trajectory", "--robot", "thing", "--waypoints", "1"], "waypoints is 1"),
        (["dual-trajectory", "--robot", "ur10"], "bolted down"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(run, tmp_path, arguments, words):
    answer = run("plan", *arguments, "--out", tmp_path / "out")
    assert answer.code == 2
    assert words in answer.sentence
    assert not (tmp_path / "out").exists()


def test_an_optimised_plan_is_drawn_beside_the_one_that_is_not(run, tmp_path):
    answer = run("plan", "dual-trajectory", "--robot", "thing", "--method", "sqp", "--waypoints", 20, "--out", tmp_path)
    assert answer.code == 0, answer.err
    assert {"optimised", "convergence"} <= {p.stem for p in (tmp_path / "figures").iterdir()}
    assert "Met everywhere: tool pose." in answer.out


def test_a_problem_comes_from_yaml(run, tmp_path):
    (tmp_path / "problem.yaml").write_text(
        "costs: [{kind: manipulability, objective: neg_log_m}]\n"
        "constraints: [{kind: tool_pose}, {kind: base_disc, radius: 0.05}, {kind: base_heading, band: 0.2}]\n"
    )
    arguments = ("plan", "dual-trajectory", "--robot", "thing", "--method", "sqp", "--waypoints", 10, "--alone")
    answer = run(*arguments, "--problem", tmp_path / "problem.yaml", "--out", tmp_path / "out")
    assert answer.code == 0, answer.err
    (tmp_path / "problem.yaml").write_text("constraints: [{kind: tool_poes}]\n")
    answer = run(*arguments, "--problem", tmp_path / "problem.yaml", "--out", tmp_path / "other")
    assert answer.code == 2
    assert "tool_poes" in answer.sentence
