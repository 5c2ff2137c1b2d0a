"""longreach run: in a process of its own, where shapes are not checked at run time, which physics is too slow for."""

import json
import subprocess
import sys

import pytest

from longreach.app.localization import spread

pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """The folder of a run of a few seconds."""
    folder = tmp_path_factory.mktemp("localization") / "out"
    command = ["-m", "longreach", "run", "localization", "--duration", "3", "--out", str(folder)]
    subprocess.run([sys.executable, *command], check=True, capture_output=True)
    return folder


def test_the_localisation_experiment_compares_all_sets_of_sensors(out):
    metrics = json.loads((out / "metrics.json").read_text())
    assert list(metrics) == ["fused", "wheels_lidar", "wheels_imu", "wheels", "lidar"]
    assert all(named["ate_rmse"]["value"] < 0.1 for named in metrics.values())
    names = {p.name for p in out.iterdir()}
    assert {f"{name}.tum" for name in (*metrics, "truth")} | {"recording.mcap", "report.html"} <= names


def test_its_recording_gives_the_same_estimate_again(out, run, tmp_path):
    again = run("estimate", out / "recording.mcap", "--robot", "thing", "--out", tmp_path)
    assert again.code == 0, again.err
    first, second = ((folder / "fused.tum").read_text().splitlines()[-1].split() for folder in (out, tmp_path))
    assert [float(v) for v in second] == pytest.approx([float(v) for v in first], abs=1e-6)


def test_many_runs_give_means_and_spreads():
    runs = [{"fused": {"ate_rmse": {"value": v, "unit": "m"}, "pairs": {"value": 3, "unit": ""}}} for v in (0.1, 0.3)]
    assert spread(runs) == {
        "fused": {
            "ate_rmse": {"value": pytest.approx(0.2), "unit": "m"},
            "ate_rmse_std": {"value": pytest.approx(0.1), "unit": "m"},
        }
    }


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["dancing"], "There is no experiment 'dancing'"),
        (["localization", "--seeds", "0"], "seeds is 0"),
        (["localization", "--floor", "lava"], "lava"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(run, tmp_path, arguments, words):
    answer = run("run", *arguments, "--out", tmp_path / "out")
    assert answer.code == 2
    assert words in answer.err.splitlines()[-1]
    assert not (tmp_path / "out").exists()
