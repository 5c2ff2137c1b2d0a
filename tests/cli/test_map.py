"""longreach map: what it leaves, and what it says about recordings that cannot be mapped."""

import csv
import json

import numpy as np
import pytest

from longreach.io.bag_writer import write_bag
from longreach.io.tum import read_tum
from longreach.mapping.map_file import load_map
from longreach.mapping.occupancy import read_map_server


def test_a_recording_is_mapped_and_all_files_are_there(run, bags, tmp_path, made):
    answer = run("map", bags / "run.mcap", "--robot", "thing", "--out", tmp_path / "out")
    assert answer.code == 0, answer.err
    out = tmp_path / "out"
    mapped, kept = read_tum(out / "mapped.tum"), load_map(out / "map.lrmap")
    assert len(mapped) == len(made.scans)
    assert len(kept.scans) == json.loads((out / "metrics.json").read_text())["map"]["keyframes"]["value"]
    assert read_map_server(out / "map.yaml").occupied.any()
    for name in ("graph.g2o", "robot.yaml", "config.yaml", "covariance.npz", "report.html", "figures/map.png"):
        assert (out / name).is_file(), name
    with (out / "closures.csv").open() as file:
        assert csv.DictReader(file).fieldnames[-4:] == ["through_back", "chi2", "blind", "window"]
    at = np.searchsorted(mapped.clock, kept.stamps)
    np.testing.assert_allclose(mapped.poses[at], kept.graph.poses, atol=1e-6)


@pytest.mark.parametrize("scans", [0, 1])
def test_a_recording_without_scans_is_refused_in_one_sentence(run, tmp_path, made, thing, scans):
    write_bag(tmp_path / "few.bag", made.replace(scans=made.scans[:scans]), thing)
    answer = run("map", tmp_path / "few.bag", "--robot", "thing", "--out", tmp_path / "out")
    assert answer.code == 2
    assert "scans" in answer.sentence
    assert not (tmp_path / "out").exists()
