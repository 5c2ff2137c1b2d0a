"""longreach map from the command line: what it writes, and a sentence for each input that cannot be mapped."""

import csv
import json
import zipfile

import numpy as np
import pytest

from longreach.io.bag_writer import write_bag
from longreach.io.config import load_description
from longreach.mapping.map_file import load_map
from longreach.sim.kinematic import make_recording

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Two drives through the same small room, as files, and a map of the first."""
    folder, thing = tmp_path_factory.mktemp("drives"), load_description("thing")
    for seed in (1, 2):
        made = make_recording(thing, seed=seed, duration=20.0, lidar_rate=5.0, beams=361)
        write_bag(folder / f"{seed}.mcap", made, thing)
    return folder


@pytest.fixture
def first(run, two):
    """The map of the first drive."""
    path = two / "first" / "map.lrmap"
    if not path.exists():
        assert run("map", two / "1.mcap", "--robot", "thing", "--out", path.parent).code == 0
    return path


def test_a_map_is_written_with_all_that_the_documents_name(run, two, first):
    found = {path.name for path in first.parent.rglob("*") if path.is_file()}
    named = {"mapped.tum", "fused.tum", "map.lrmap", "map.pgm", "map.yaml", "graph.g2o", "closures.csv", "truth.tum"}
    assert named | {"metrics.json", "config.yaml", "robot.yaml", "report.html", "map.png", "uncertainty.png"} <= found
    metrics = json.loads((first.parent / "metrics.json").read_text())
    assert metrics["map"]["keyframes"]["value"] == len(load_map(first).scans) > 5
    assert metrics["mapped"]["ate_rmse"]["value"] < 0.02


@pytest.mark.long
def test_two_recordings_and_one_that_is_added_to_the_map_of_the_other_are_one_map(run, two, first, tmp_path):
    both = run("map", two / "1.mcap", two / "2.mcap", "--robot", "thing", "--out", tmp_path / "both")
    added = run("map", two / "2.mcap", "--robot", "thing", "--add-to", first, "--out", tmp_path / "added")
    assert (both.code, added.code) == (0, 0), both.err + added.err
    one, other = load_map(tmp_path / "both" / "map.lrmap"), load_map(tmp_path / "added" / "map.lrmap")
    assert [session.name for session in one.sessions] == [session.name for session in other.sessions]
    np.testing.assert_allclose(one.graph.poses, other.graph.poses, atol=1e-9)
    assert len(one.scans) > len(load_map(first).scans)
    assert (tmp_path / "both" / "mapped_2.tum").is_file()
    with (tmp_path / "added" / "closures.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sum(row["status"] == "accepted" for row in rows) >= 3


def test_the_same_recording_twice_is_refused(run, two, first, tmp_path):
    answer = run("map", two / "1.mcap", "--robot", "thing", "--add-to", first, "--out", tmp_path / "out")
    assert (answer.code, answer.sentence) == (2, "longreach: 1 is in the map already; leave it out.")
    answer = run("map", two / "1.mcap", two / "1.mcap", "--robot", "thing", "--out", tmp_path / "out")
    assert (answer.code, answer.sentence) == (2, "longreach: 1 is there twice; give each recording once.")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("scans", [0, 1])
def test_a_recording_with_too_few_scans_is_named(run, made, thing, bags, tmp_path, scans):
    write_bag(tmp_path / "few.mcap", made.replace(scans=made.scans[:scans]), thing)
    answer = run("map", bags / "run.mcap", tmp_path / "few.mcap", "--robot", "thing", "--out", tmp_path / "out")
    what = ("no scans", "1 scan")[scans]
    assert answer.code == 2
    assert answer.sentence == f"longreach: few has {what}; a map takes two scans of a LIDAR at least."
    assert not (tmp_path / "out").exists()


def changed(path, to, name, change):
    with zipfile.ZipFile(path) as archive:
        members = {member: archive.read(member) for member in archive.namelist()}
    members[name] = change(members[name])
    with zipfile.ZipFile(to, "w") as archive:
        for member, data in members.items():
            archive.writestr(member, data)


def damaged(kind, first, folder):
    path = folder / "old.lrmap"
    if kind == "short":
        path.write_bytes(first.read_bytes()[:-100])
    elif kind == "checksum":
        changed(first, path, "graph.npz", lambda data: data[:200] + bytes([data[200] ^ 1]) + data[201:])
    elif kind == "version":
        changed(first, path, "map.json", lambda data: data.replace(b'"version": 1', b'"version": 9'))
    elif kind == "image":
        path.write_bytes((first.parent / "map.pgm").read_bytes())
    return path


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [
        ("short", "is cut short: its end is missing; take a copy, or build the map again."),
        ("checksum", "is damaged: graph.npz has another checksum than when it was written; take a copy"),
        ("version", "is a map of version 9, and this longreach reads 1; use a longreach as new as the one"),
        ("image", "is no map of longreach (map.lrmap)."),
        ("none", "is not there."),
    ],
)
def test_a_map_that_cannot_be_added_to_is_said_before_the_recording_is_read(run, first, tmp_path, kind, sentence):
    path = damaged(kind, first, tmp_path)
    before = path.read_bytes() if path.exists() else None
    answer = run("map", tmp_path / "nowhere.mcap", "--robot", "thing", "--add-to", path, "--out", tmp_path / "out")
    assert answer.code == 2
    assert sentence in answer.sentence
    assert not (tmp_path / "out").exists()
    assert (path.read_bytes() if path.exists() else None) == before


def test_a_robot_with_another_laser_or_another_mount_is_not_the_maps(run, two, first, thing, tmp_path):
    description = thing.model_dump(mode="json")
    description["lidar"]["mount"]["x"] += 0.4
    (tmp_path / "other.yaml").write_text(json.dumps(description), encoding="utf-8")
    answer = run(
        "map", two / "2.mcap", "--robot", tmp_path / "other.yaml", "--add-to", first, "--out", tmp_path / "out"
    )
    assert answer.code == 2
    assert "is mounted 0.40 m and 0° from where that of the map is, which is of thing; give" in answer.sentence
    coarse = make_recording(thing, seed=3, duration=2.0, lidar_rate=5.0, beams=91)
    write_bag(tmp_path / "coarse.mcap", coarse, thing)
    answer = run("map", tmp_path / "coarse.mcap", "--robot", "thing", "--add-to", first, "--out", tmp_path / "out")
    assert answer.code == 2
    assert "The scans are of another laser than the map's: " in answer.sentence
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_is_said_first(run, two, tmp_path):
    (tmp_path / "file").write_text("mine")
    answer = run("map", two / "1.mcap", "--robot", "thing", "--out", tmp_path / "file")
    assert (answer.code, answer.sentence) == (
        2,
        f"longreach: {tmp_path / 'file'} is a file; give a folder for the results.",
    )
    assert (tmp_path / "file").read_text() == "mine"


def test_a_truth_file_is_of_one_recording(run, two, tmp_path):
    (tmp_path / "truth.tum").write_text("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")
    files = two / "1.mcap", two / "2.mcap"
    answer = run("map", *files, "--robot", "thing", "--truth", tmp_path / "truth.tum", "--out", tmp_path / "out")
    assert answer.code == 2
    assert answer.sentence.endswith("truth.tum is the truth of one recording; map one at a time to compare with it.")


@pytest.mark.parametrize("where", ["longreach.app.results.style.png", "longreach.app.map.refined"])
def test_an_interrupt_leaves_the_map_that_was_there(run, bags, tmp_path, monkeypatch, where):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "map.lrmap").write_text("old")
    monkeypatch.setattr(where, interrupt)
    answer = run("map", bags / "run.mcap", "--robot", "thing", "--out", tmp_path / "out")
    assert (answer.code, answer.sentence) == (130, "longreach: interrupted; nothing half-written is left behind.")
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "out", tmp_path / "out" / "map.lrmap"]
    assert (tmp_path / "out" / "map.lrmap").read_text() == "old"
