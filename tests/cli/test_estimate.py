"""longreach estimate: what it leaves, and what it says about files that cannot be used."""

import bz2
import gzip
import json
from dataclasses import replace

import numpy as np
import pytest

from longreach.io import messages
from longreach.io.bag_writer import new_bag, write_bag
from longreach.io.config import to_yaml
from longreach.io.tum import read_tum, write_tum
from longreach.trajectory import PoseTrajectory

LEFT = {"fused.tum", "wheels.tum", "lidar.tum", "truth.tum", "covariance.npz", "lidar_matches.npz", "metrics.json"}
LEFT |= {"config.yaml", "robot.yaml", "report.html", "figures"}


def flaser(stamp, i, count=60):
    """A robot that drives 5 cm a scan towards a wall and past a corner."""
    angles = -np.pi / 2 + np.pi / count * np.arange(count)
    with np.errstate(divide="ignore"):
        ranges = np.minimum((4.0 - 0.05 * i) / np.maximum(np.cos(angles), 1e-9), 2.0 / np.abs(np.sin(angles)))
    pose = f"{0.05 * i:.3f} 0 0"
    return f"FLASER {count} {' '.join(f'{r:.3f}' for r in ranges)} {pose} {pose} {stamp:.6f} nohost 0\n"


@pytest.fixture
def carmen(tmp_path):
    def write(stamps, counts=None, name="a.log"):
        counts = counts or [60] * len(stamps)
        text = "".join(flaser(s, i, n) for i, (s, n) in enumerate(zip(stamps, counts, strict=True)))
        squeeze = {"gz": gzip.compress, "bz2": bz2.compress}.get(name.rpartition(".")[2], lambda raw: raw)
        (tmp_path / name).write_bytes(squeeze(text.encode()))
        return tmp_path / name

    return write


@pytest.fixture
def refused(run, tmp_path):
    """Run an estimate that must end in one sentence, code 2, and nothing written."""

    def estimate(*arguments):
        before = sorted(tmp_path.rglob("*"))
        answer = run("estimate", *arguments, "--out", tmp_path / "out")
        assert (answer.code, answer.out) == (2, "")
        assert sorted(tmp_path.rglob("*")) == before
        sentence = answer.sentence
        assert sentence.startswith("longreach: ")
        assert sentence.endswith((".", ".)", "?"))
        return sentence

    return estimate


@pytest.mark.parametrize("name", ["run.bag", "run.mcap", "run"])
def test_every_kind_of_bag_is_estimated(run, bags, tmp_path, name, made):
    answer = run("estimate", bags / name, "--robot", "thing", "--out", tmp_path / "out")
    assert answer.code == 0, answer.err
    assert {path.name for path in (tmp_path / "out").iterdir()} == LEFT
    assert sorted(tmp_path.iterdir()) == [tmp_path / "out"]
    assert "fused" in answer.out
    assert answer.out.splitlines()[-1].startswith("Everything is in ")
    stamps = {*(w.stamp for w in made.wheels), *(s.stamp for s in made.scans)}
    np.testing.assert_allclose(read_tum(tmp_path / "out" / "fused.tum").stamps, sorted(stamps), atol=1e-8)


@pytest.mark.parametrize("name", ["a.log", "a.clf", "a.log.gz", "a.clf.bz2"])
def test_a_log_is_estimated_with_its_own_stamps(run, carmen, tmp_path, name):
    stamps = [976052857.0, 976052857.2, 976052857.1, 976052857.6, 976052857.8]
    answer = run("estimate", carmen(stamps, name=name), "--robot", "intel", "--compare", "--out", tmp_path / "out")
    assert answer.code == 0, answer.err
    assert "note: 1 of 5 stamps run backwards; the order of the file was kept" in answer.out
    for path in ("fused", "wheels", "lidar"):
        np.testing.assert_array_equal(read_tum(tmp_path / "out" / f"{path}.tum").stamps, stamps)


def test_all_that_can_be_given_is_used(run, bags, tmp_path, made):
    (tmp_path / "c.yaml").write_text("{lidar: {distance: 0.5}, evaluation: {align: none}}")
    write_tum(tmp_path / "truth.tum", made.truth)
    (tmp_path / "a.relations").write_text("0.0 0.5 0 0 0 0 0 0\n")
    options = {
        "--robot": "thing",
        "--config": tmp_path / "c.yaml",
        "--truth": tmp_path / "truth.tum",
        "--relations": tmp_path / "a.relations",
        "--sources": "wheels,lidar,fixes",
        "--fixes": tmp_path / "truth.tum",
        "--fix-sigma": 0.001,
        "--fix-period": 0.5,
        "--out": tmp_path / "out",
    }
    answer = run("estimate", bags / "run.mcap", *(str(x) for pair in options.items() for x in pair))
    assert answer.code == 0, answer.err
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    fused, localized = metrics["fused"], metrics["localized"]
    assert {"ate_rmse", "relations_5s_translation_mean"} <= set(fused) & set(localized)
    assert "nis_imu_mean" not in fused
    assert localized["nis_fixes_rows"]["value"] == 2  # the first one leaves the heading open
    assert (tmp_path / "out" / "localized.tum").is_file()
    assert "distance: 0.5" in (tmp_path / "out" / "config.yaml").read_text()


def test_a_topic_is_the_truth(run, bags, tmp_path):
    answer = run("estimate", bags / "run.bag", "--robot", "thing", "--truth", "/truth", "--out", tmp_path / "out")
    assert answer.code == 0, answer.err


def test_a_robot_is_a_file_too(run, bags, tmp_path, thing):
    (tmp_path / "mine.yaml").write_text(to_yaml(thing.model_copy(update={"arm": None, "tool": None})))
    answer = run("estimate", bags / "run.mcap", "--robot", tmp_path / "mine.yaml", "--out", tmp_path / "out")
    assert answer.code == 0, answer.err


def test_results_are_replaced_and_other_files_stay(run, bags, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    (tmp_path / "out" / "fused.tum").write_text("old")
    assert run("estimate", bags / "run.mcap", "--robot", "thing", "--out", tmp_path / "out").code == 0
    assert (tmp_path / "out" / "mine.txt").read_text() == "mine"
    assert len(read_tum(tmp_path / "out" / "fused.tum")) > 50


def test_an_interrupt_leaves_what_was_there(run, bags, tmp_path, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "fused.tum").write_text("old")
    monkeypatch.setattr("longreach.app.results.style.png", interrupt)
    answer = run("estimate", bags / "run.mcap", "--robot", "thing", "--out", tmp_path / "out")
    assert (answer.code, answer.sentence) == (130, "longreach: interrupted; nothing half-written is left behind.")
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "out", tmp_path / "out" / "fused.tum"]
    assert (tmp_path / "out" / "fused.tum").read_text() == "old"


def test_time_steps_of_length_zero_are_taken(run, carmen, made, thing, tmp_path):
    answer = run("estimate", carmen([5.0] * 6), "--robot", "intel", "--out", tmp_path / "out")
    assert answer.code == 0, answer.err
    assert "note: 5 of 6 stamps run backwards" in answer.out
    np.testing.assert_array_equal(read_tum(tmp_path / "out" / "fused.tum").stamps, 5.0)
    twice = (*made.scans[:5], replace(made.scans[5], stamp=made.scans[4].stamp), *made.scans[6:])
    write_bag(tmp_path / "a.mcap", made.replace(scans=twice), thing)
    answer = run("estimate", tmp_path / "a.mcap", "--robot", "thing", "--out", tmp_path / "b")
    assert answer.code == 0, answer.err


def test_a_bag_whose_time_runs_backwards_is_repaired_and_that_is_said(run, made, thing, tmp_path):
    scans = list(made.scans)
    scans[4], scans[5] = replace(scans[4], stamp=scans[5].stamp), replace(scans[5], stamp=scans[4].stamp)
    with new_bag(tmp_path / "a.bag") as bag:
        for i, scan in enumerate(scans):
            bag.write("/front/scan", messages.laser_scan(bag.types, scan.stamp, scan), 100.0 + i)
    answer = run("estimate", tmp_path / "a.bag", "--robot", "thing", "--out", tmp_path / "out")
    assert answer.code == 0, answer.err
    assert "note: 1 stamps of /front/scan run backwards; they were repaired in the order of the file." in answer.out
    np.testing.assert_allclose(read_tum(tmp_path / "out" / "lidar.tum").stamps, [s.stamp for s in scans], atol=1e-8)


def test_beams_of_changing_count_are_said(run, carmen, tmp_path):
    answer = run(
        "estimate", carmen([1.0, 1.2, 1.4, 1.6], [60, 60, 90, 90]), "--robot", "intel", "--out", tmp_path / "out"
    )
    assert answer.code == 0, answer.err
    assert "note: The number of beams changes within the log." in answer.out
    assert "gave no match" not in answer.out


def test_a_bag_that_is_none_is_refused(refused, tmp_path):
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(range(256)) * 20)
    said = refused(tmp_path / "a.bag", "--robot", "thing")
    assert "a.bag cannot be read as a ROS bag, it is damaged or cut short" in said
    (tmp_path / "b.bag").write_bytes(b"#ROSBAG V1.2\n" + bytes(5000))
    assert "b.bag is a ROS bag of a version before 2.0" in refused(tmp_path / "b.bag", "--robot", "thing")


def test_a_bag_cut_short_before_its_first_message_is_refused(refused, bags, tmp_path):
    for name in ("run.bag", "run.mcap"):
        (tmp_path / name).write_bytes((bags / name).read_bytes()[:200])
        said = refused(tmp_path / name, "--robot", "thing")
        assert f"{name} cannot be read as a ROS bag, it is damaged or cut short" in said


def test_a_log_with_nothing_whole_in_it_is_refused(refused, carmen):
    path = carmen([1.0, 1.2, 1.4], name="a.clf.bz2")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert f"{path.name} is cut short: its compressed data end too early." in refused(path, "--robot", "intel")


def test_a_line_cut_short_is_left_out_and_named(run, carmen, tmp_path):
    path = carmen([1.0, 1.2, 1.4, 1.6])
    path.write_text(path.read_text()[:-30])
    answer = run("estimate", path, "--robot", "intel", "--out", tmp_path / "out")
    assert answer.code == 0, answer.err
    assert "a.log, line 4: a FLASER line of 60 ranges is cut short" in " ".join(answer.out.split())


def test_a_missing_topic_is_answered_with_those_that_are_there(refused, bags, tmp_path, thing):
    topics = thing.topics.model_copy(update={"lidar": "/scan"})
    (tmp_path / "r.yaml").write_text(to_yaml(thing.model_copy(update={"topics": topics, "arm": None, "tool": None})))
    said = refused(bags / "run.mcap", "--robot", tmp_path / "r.yaml")
    assert "has no topic /scan for lidar; it has " in said
    assert "/front/scan (sensor_msgs/msg/LaserScan)" in said
    said = refused(bags / "run.mcap", "--robot", "thing", "--truth", "/mocap")
    assert "has no topic /mocap for truth; it has " in said


def test_a_topic_of_a_type_that_cannot_be_read_is_refused(refused, tmp_path):
    with new_bag(tmp_path / "a.mcap") as bag:
        bag.write("/front/scan", bag.types["std_msgs/msg/String"]("x"), 1.0)
    said = refused(tmp_path / "a.mcap", "--robot", "thing")
    assert "/front/scan is of type std_msgs/msg/String, but lidar are read from sensor_msgs/msg/LaserScan" in said


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.log", "", "a.log is empty; record or copy it again."),
        (
            "a.log",
            "# a comment\n",
            "holds no FLASER, ROBOTLASER, RAWLASER or ODOM lines, so it is no CARMEN log; it has no lines at all",
        ),
        ("a.log", "hello world\n", "so it is no CARMEN log; it has hello"),
        ("a.bag", "", "a.bag is empty; record or copy it again."),
        ("a.txt", "hello", "a.txt is of no known format: a recording is a ROS 1 .bag"),
        ("a.log", flaser(1.0, 0), "There is nothing to fuse: 1 wheel records, 1 scans, "),
        ("a.log", flaser(1.5e18, 0), "looks like nanoseconds; stamps are seconds."),
    ],
    ids=["empty", "comment", "words", "empty bag", "text", "one scan", "nanoseconds"],
)
def test_a_file_that_holds_no_recording_is_refused(refused, tmp_path, name, content, sentence):
    (tmp_path / name).write_text(content)
    assert sentence in refused(tmp_path / name, "--robot", "intel")


def test_one_scan_in_a_bag_is_refused(refused, made, thing, tmp_path):
    write_bag(tmp_path / "a.mcap", made.replace(wheels=(), imu=(), scans=made.scans[:1], truth=None), thing)
    assert "nothing to fuse: 0 wheel records, 1 scans" in refused(tmp_path / "a.mcap", "--robot", "thing")


@pytest.mark.parametrize(
    ("option", "given", "sentence"),
    [
        ("--config", "nowhere.yaml", "nowhere.yaml is not there."),
        ("--relations", "nowhere.relations", "nowhere.relations is not there."),
        ("--fixes", "nowhere.tum", "nowhere.tum is not there."),
        ("--truth", "nowhere.tum", "nowhere.tum is not there; the truth is a file or a topic of the recording."),
        ("--sources", "wheels,sonar", "sources.1 is 'sonar': input should be 'wheels', 'lidar', 'imu' or 'fixes'."),
        ("--sources", "fixes", "The recording has no fixes to fuse; it has wheels, lidar, imu."),
        ("--robot", "wall-e", "wall-e is neither a robot that longreach knows (aces, brenner, csail, fr079, "),
    ],
)
def test_what_is_not_there_is_said(refused, bags, option, given, sentence):
    robot = [] if option == "--robot" else ["--robot", "thing"]
    assert sentence in refused(bags / "run.mcap", *robot, option, given)


def test_a_recording_that_is_not_there_is_said(refused, tmp_path):
    assert "There is no recording at nowhere.bag; check the path." in refused("nowhere.bag", "--robot", "thing")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("lidar: {level: 3}", "c.yaml: lidar.level is not a key here; there are: method, iterations, gate"),
        ("filter: {history: -1}", "c.yaml: filter.history is -1: input should be greater than or equal to 0."),
        ("sources: wheels", "c.yaml: sources is 'wheels': input should be a valid tuple."),
        ("filter: [", "c.yaml, line 1: this is not YAML"),
    ],
)
def test_a_key_that_cannot_be_read_is_said(refused, bags, tmp_path, text, sentence):
    (tmp_path / "c.yaml").write_text(text)
    assert sentence in refused(bags / "run.mcap", "--robot", "thing", "--config", tmp_path / "c.yaml")


@pytest.mark.parametrize(("option", "given"), [("--fix-sigma", "-1"), ("--fix-sigma", "0"), ("--fix-period", "-1")])
def test_fixes_that_make_no_sense_are_refused(refused, bags, tmp_path, made, option, given):
    write_tum(tmp_path / "fixes.tum", made.truth)
    said = refused(bags / "run.mcap", "--robot", "thing", "--fixes", tmp_path / "fixes.tum", option, given)
    assert f"{option} is {given}; a " in said


def test_references_of_another_time_are_refused(refused, bags, tmp_path, made):
    write_tum(tmp_path / "ns.tum", PoseTrajectory(1e9 * made.truth.stamps[1:] + 1e18, made.truth.poses[1:]))
    said = refused(bags / "run.mcap", "--robot", "thing", "--truth", tmp_path / "ns.tum")
    assert "have no time in common; give both on one clock." in said
    (tmp_path / "a.relations").write_text("1e9 2e9 0 0 0 0 0 0\n")
    said = refused(bags / "run.mcap", "--robot", "thing", "--relations", tmp_path / "a.relations")
    assert "No relation has both stamps within the trajectories; are they of this recording?" in said


def test_a_file_where_the_results_should_go_is_said(run, bags, tmp_path):
    (tmp_path / "out").write_text("mine")
    answer = run("estimate", bags / "run.mcap", "--robot", "thing", "--out", tmp_path / "out")
    assert (answer.code, answer.out) == (2, "")
    assert "out is a file; give a folder for the results." in answer.sentence
    assert (tmp_path / "out").read_text() == "mine"
    assert answer.err.strip() == answer.sentence  # said before any work


def test_a_recording_is_localised_in_a_map_that_another_run_made(run, bags, tmp_path, made, refused):
    assert run("map", bags / "run.mcap", "--robot", "thing", "--out", tmp_path / "map").code == 0
    map_file = tmp_path / "map" / "map.lrmap"
    answer = run("estimate", bags / "run.mcap", "--robot", "thing", "--map", map_file, "--out", tmp_path / "there")
    assert answer.code == 0, answer.err
    metrics = json.loads((tmp_path / "there" / "metrics.json").read_text())["localized"]
    assert metrics["ate_rmse"]["value"] < 0.01
    assert {"heading_rms", "nees_mean", "nis_map_mean"} <= set(metrics)
    assert len(read_tum(tmp_path / "there" / "localized.tum")) == len(made.scans)
    mapped = ("--robot", "thing", "--map", map_file)
    assert "which goes from" in refused(bags / "run.mcap", *mapped, "--start", "90,0,0")
    assert "x,y,theta" in refused(bags / "run.mcap", *mapped, "--start", "there")
    assert "give --map as well" in refused(bags / "run.mcap", "--robot", "thing", "--start", "0,0,0")
    assert "is not there" in refused(bags / "run.mcap", "--robot", "thing", "--map", tmp_path / "none.lrmap")
