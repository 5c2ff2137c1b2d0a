"""longreach info, evaluate and warmup."""

import json
import re

import numpy as np
import pytest

import longreach
from longreach.io.bag_writer import write_bag
from longreach.io.tum import write_tum
from longreach.measurement import Imu
from longreach.trajectory import PoseTrajectory


@pytest.mark.parametrize(("name", "format"), [("run.bag", "ROS 1 bag"), ("run.mcap", "MCAP"), ("run", "ROS 2 bag")])
def test_info_lists_topics_rates_and_duration(run, bags, name, format):
    answer = run("info", bags / name)
    assert answer.code == 0, answer.err
    assert answer.err == ""
    assert f"{name}: {format}, 1.0 s from 0.000000" in answer.out
    row = next(line.split() for line in answer.out.splitlines() if line.startswith("/joint_states"))
    assert row[1:] == ["sensor_msgs/msg/JointState", "51", "50.0", "0.020", "0"]


def test_info_takes_topics_and_a_clock(run, bags):
    answer = run("info", bags / "run.mcap", "--topic", "wheels=/joint_states", "--clock", "record")
    assert answer.code == 0, answer.err
    answer = run("info", bags / "run.mcap", "--topic", "lidar=/joint_states")
    assert answer.code == 2
    assert "/joint_states is of type sensor_msgs/msg/JointState, but lidar are read from" in answer.sentence


def test_topics_and_clocks_are_for_bags(run, tmp_path):
    (tmp_path / "a.log").write_text("ODOM 0 0 0 0 0 0 1 nohost 0")
    for options in (("--topic", "lidar=/scan"), ("--clock", "record")):
        answer = run("info", tmp_path / "a.log", *options)
        assert "has neither topics nor times of recording; --topic and --clock are for bags" in answer.sentence
        answer = run("estimate", tmp_path / "a.log", "--robot", "intel", "--out", tmp_path / "out", *options)
        assert re.search("has no topics, so there is no /scan|has no times of recording beside", answer.sentence)


def test_the_version_is_printed(run):
    answer = run("--version")
    assert (answer.code, answer.out, answer.err) == (0, f"longreach {longreach.__version__}\n", "")


def test_info_tells_of_a_log(run, tmp_path):
    ranges = " ".join(["2.0"] * 30)
    lines = [f"FLASER 30 {ranges} 0 0 0 0 0 0 {stamp} nohost 0" for stamp in (5.0, 5.2, 5.1)]
    (tmp_path / "a.log").write_text("\n".join(["PARAM a b c", *lines]))
    answer = run("info", tmp_path / "a.log")
    assert answer.code == 0
    assert "a.log: CARMEN log, 0.2 s from 5.000000" in answer.out
    row = next(line.split() for line in answer.out.splitlines() if line.startswith("FLASER"))
    assert (row[-4], row[-1]) == ("3", "1")
    assert "note: Scans have 30 beams." in answer.out
    assert "note: 1 PARAM lines are not used." in answer.out


def test_info_with_a_robot_says_what_is_wrong_or_that_nothing_is(run, tmp_path, bags, made, thing):
    assert "Nothing is wrong with it" in run("info", bags / "run.mcap", "--robot", "thing").out
    leaning = tuple(Imu(one.stamp, one.angular_velocity, one.acceleration[[2, 0, 1]]) for one in made.imu)
    write_bag(tmp_path / "leaning.mcap", made.replace(imu=leaning), thing)
    assert "note: Gravity leans by 90°" in run("info", tmp_path / "leaning.mcap", "--robot", "thing").out


def test_what_is_assumed_takes_the_place_of_what_is_described(run, tmp_path, bags):
    recording, robot = bags / "run.mcap", ("--robot", "thing")
    assert "Gravity leans" in run("info", recording, *robot, "--assume", "imu.mount.roll=1.5708").out
    for assumed, sentence in (
        ("imu.colour=red", "longreach: --assume: imu.colour is not a key here"),
        ("imu", "longreach: --assume imu is not of the form NAME=VALUE"),
    ):
        answer = run("info", recording, *robot, "--assume", assumed)
        assert answer.code == 2
        assert answer.sentence.startswith(sentence)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("nowhere.bag", None, "There is no recording at"),
        ("a.bag", b"#ROSBAG V2.0\nnonsense", "cannot be read as a ROS bag, it is damaged or cut short"),
        ("a.log", b"", "is empty; record or copy it again."),
        ("a.txt", b"x", "is of no known format"),
    ],
)
def test_info_refuses_in_one_sentence(run, tmp_path, name, content, sentence):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    answer = run("info", tmp_path / name)
    assert (answer.code, answer.out) == (2, "")
    assert sentence in answer.sentence


@pytest.fixture(scope="module")
def truth():
    stamps = np.linspace(0.0, 5.0, 101)
    return PoseTrajectory(stamps, np.column_stack([stamps, np.sin(stamps), np.arctan(np.cos(stamps))]))


def test_evaluate_compares_a_file_with_a_file(run, tmp_path, truth):
    write_tum(tmp_path / "truth.tum", truth)
    write_tum(tmp_path / "mine.tum", PoseTrajectory(truth.stamps, truth.poses + np.array([3.0, 4.0, 0.0])))
    (tmp_path / "a.relations").write_text("0 2 2.0 0.9 0 0 0 -1.0\n")
    answer = run(
        *("evaluate", tmp_path / "mine.tum", "--truth", tmp_path / "truth.tum"),
        *("--relations", tmp_path / "a.relations", "--out", tmp_path / "out"),
    )
    assert answer.code == 0, answer.err
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["mine"]["ate_rmse"]["value"] == pytest.approx(0.0, abs=1e-6)
    assert metrics["mine"]["relations_5s_used"]["value"] == 1
    assert {"metrics.json", "report.html", "config.yaml", "figures"} == {p.name for p in (tmp_path / "out").iterdir()}
    assert "mine" in answer.out


def test_evaluate_takes_the_folder_of_an_estimate(run, bags, tmp_path):
    assert run("estimate", bags / "run.mcap", "--robot", "thing", "--out", tmp_path / "run").code == 0
    answer = run("evaluate", tmp_path / "run", "--out", tmp_path / "out")
    assert answer.code == 0, answer.err
    assert list(json.loads((tmp_path / "out" / "metrics.json").read_text())) == ["fused", "wheels", "lidar"]


def test_evaluate_refuses_in_one_sentence(run, tmp_path, truth):
    write_tum(tmp_path / "truth.tum", truth)
    write_tum(tmp_path / "late.tum", PoseTrajectory(truth.stamps + 100.0, truth.poses))
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.tum").write_text("0 1 2 3 0 0 0 0\n")
    before = sorted(tmp_path.rglob("*"))
    for arguments, sentence in (
        (["nowhere.tum", "--truth", tmp_path / "truth.tum"], "nowhere.tum is not there."),
        ([tmp_path / "truth.tum", "--truth", "nowhere.tum"], "nowhere.tum is not there."),
        ([tmp_path / "truth.tum"], "; give --truth or --relations."),
        ([tmp_path / "empty"], "holds no trajectories (*.tum)."),
        ([tmp_path / "bad.tum", "--truth", tmp_path / "truth.tum"], "bad.tum, line 1: the quaternion is zero."),
        ([tmp_path / "late.tum", "--truth", tmp_path / "truth.tum"], "have no time in common; give both on one clock."),
    ):
        answer = run("evaluate", *arguments, "--out", tmp_path / "out")
        assert (answer.code, answer.out) == (2, "")
        assert sentence in answer.sentence
        assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.system
def test_warmup_says_where_the_kernels_are(run):
    answer = run("warmup")
    assert answer.code == 0, answer.err
    assert answer.out.startswith("All kernels are compiled (")


def kitti(path, trajectory):
    x, y, heading = trajectory.poses.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    c, s = np.cos(heading), np.sin(heading)
    np.savetxt(path, np.column_stack([c, -s, zero, x, s, c, zero, y, zero, zero, one, zero]))
    return path


def ate(out):
    return json.loads((out / "metrics.json").read_text())["mine"]["ate_rmse"]["value"]


def test_evaluate_gives_poses_of_kitti_the_stamps_of_the_other_file(run, tmp_path, truth):
    write_tum(tmp_path / "truth.tum", truth)
    bent = PoseTrajectory(truth.stamps, truth.poses * np.array([1.1, 1.0, 1.0]))
    write_tum(tmp_path / "mine.tum", bent)
    answer = run("evaluate", tmp_path / "mine.tum", "--truth", tmp_path / "truth.tum", "--out", tmp_path / "tum")
    assert answer.code == 0, answer.err
    pairs = [
        ("mine.txt", "truth.tum", "note: mine.txt: poses of KITTI have no stamps; those of truth.tum are taken"),
        ("mine.tum", "truth.txt", "note: truth.txt: poses of KITTI have no stamps; those of mine.tum are taken"),
        ("mine.txt", "truth.txt", "note: mine.txt: poses of KITTI have no stamps; the numbers of lines are taken"),
    ]
    kitti(tmp_path / "mine.txt", bent)
    kitti(tmp_path / "truth.txt", truth)
    for i, (mine, known, said) in enumerate(pairs):
        answer = run("evaluate", tmp_path / mine, "--truth", tmp_path / known, "--out", tmp_path / str(i))
        assert answer.code == 0, answer.err
        assert said in answer.out
        assert ate(tmp_path / str(i)) == pytest.approx(ate(tmp_path / "tum"), rel=1e-6)


def test_evaluate_refuses_poses_without_stamps_that_are_not_as_many(run, tmp_path, truth):
    write_tum(tmp_path / "mine.tum", PoseTrajectory(truth.stamps[:50], truth.poses[:50]))
    kitti(tmp_path / "truth.txt", truth)
    answer = run("evaluate", tmp_path / "mine.tum", "--truth", tmp_path / "truth.txt", "--out", tmp_path / "out")
    assert answer.code == 2
    assert "have no stamps, and" in answer.sentence
    assert answer.sentence.endswith("put their times.txt beside truth.txt.")


def test_evaluate_takes_what_is_known_of_the_files(run, tmp_path, truth):
    write_tum(tmp_path / "mine.tum", truth)
    lines = [line.split() for line in (tmp_path / "mine.tum").read_text().splitlines()[1:]]
    (tmp_path / "truth.txt").write_text("\n".join(" ".join([*w[:4], w[7], *w[4:7]]) for w in lines))
    for options in ((), ("--assume", "quaternion=wxyz")):
        out = tmp_path / f"out{len(options)}"
        command = ("evaluate", tmp_path / "mine.tum", "--truth", tmp_path / "truth.txt", "--out", out)
        answer = run(*command, *options)
        assert ate(out) < 1e-6
        assert ("note: truth.txt: its quaternions are taken for w x y z" in answer.out) == (not options)
    answer = run(*command, "--assume", "colour=red")
    assert "colour=red is nothing that can be assumed of a trajectory" in answer.sentence
