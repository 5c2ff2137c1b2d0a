"""longreach run: in a process of its own, where shapes are not checked at run time, which physics is too slow for."""

import json
import subprocess
import sys
import weakref
from html import unescape

import numpy as np
import pytest

from longreach.app.experiments import Experiment
from longreach.app.localization import LocalizationConfig
from longreach.app.seeds import first_run, spread
from longreach.errors import EstimationError
from longreach.evaluation.tables import failures, metric, outcome

pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """The folder of a run of a few seconds."""
    folder = tmp_path_factory.mktemp("localization") / "out"
    command = ["-m", "longreach", "run", "localization", "--duration", "3", "--out", str(folder)]
    subprocess.run([sys.executable, *command], check=True, capture_output=True)
    return folder


@pytest.mark.long
def test_the_localisation_experiment_compares_all_sets_of_sensors(out):
    metrics = json.loads((out / "metrics.json").read_text())
    assert list(metrics) == ["fused", "wheels_lidar", "wheels_imu", "wheels", "lidar"]
    assert all(named["ate_rmse"]["value"] < 0.1 for named in metrics.values())
    names = {p.name for p in out.iterdir()}
    assert {f"{name}.tum" for name in (*metrics, "truth")} | {"recording.mcap", "report.html"} <= names


@pytest.mark.long
def test_its_recording_gives_the_same_estimate_again(out, run, tmp_path):
    again = run("estimate", out / "recording.mcap", "--robot", "thing", "--out", tmp_path)
    assert again.code == 0, again.err
    first, second = ((folder / "fused.tum").read_text().splitlines()[-1].split() for folder in (out, tmp_path))
    assert [float(v) for v in second] == pytest.approx([float(v) for v in first], abs=1e-6)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """The folder of a short line drawn with the loop closed and open."""
    folder = tmp_path_factory.mktemp("dual") / "out"
    command = ["-m", "longreach", "run", "dual-trajectory", "--length", "0.3", "--out", str(folder)]
    subprocess.run([sys.executable, *command], check=True, capture_output=True)
    return folder


@pytest.mark.long
def test_the_hand_is_where_the_robot_thinks_as_far_as_it_knows_where_it_is(drawn):
    metrics = json.loads((drawn / "metrics.json").read_text())
    assert list(metrics)[:2] == ["closed", "open"]
    closed = {name: m["value"] for name, m in metrics["closed"].items()}
    assert closed["tool_tracking_error"] < 0.003
    assert closed["tool_error"] <= closed["tool_estimate_error"] + 0.003
    assert closed["tool_height_error_max"] < 0.001
    names = {p.name for p in drawn.iterdir()}
    assert {f"tool_{what}.tum" for what in ("reference", "estimate", "truth")} <= names
    assert {"fused.tum", "wheels.tum", "lidar.tum", "truth.tum", "recording.mcap", "recording_open.mcap"} <= names


@pytest.mark.long
def test_a_replay_of_its_recording_gives_the_estimate_that_the_robot_drove_by(drawn, run, tmp_path):
    assert json.loads((drawn / "metrics.json").read_text())["closed"]["replay_difference_max"]["value"] < 1e-6
    again = run("estimate", drawn / "recording.mcap", "--robot", "thing", "--out", tmp_path)
    assert again.code == 0, again.err
    first, second = (np.loadtxt(folder / "fused.tum") for folder in (drawn, tmp_path))
    np.testing.assert_allclose(second, first, atol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize(
    ("experiment", "stands", "run"),
    [("dual-trajectory --length 0.8", 0.9, "closed"), ("manipulability --objective neg_log_m", 0.9, "optimised")],
)
def test_a_run_that_hits_a_wall_says_so_first_everywhere_and_ends_with_1(tmp_path, experiment, stands, run):
    wall = f"{{x: {stands}, y: 0, length: 0.1, width: 2, height: 0.4}}"
    (tmp_path / "wall.yaml").write_text(f"name: wall\nboxes: [{wall}, {{x: 0, y: -4, length: 9, width: 1}}]")
    command = ["-m", "longreach", "run", *experiment.split(), "--world", "wall.yaml", "--out", "out"]
    ended = subprocess.run([sys.executable, *command], cwd=tmp_path, capture_output=True, text=True)
    assert ended.returncode == 1, ended.stderr
    first = ended.stdout.splitlines()[0]
    assert first.startswith(f"{run} did not reach its end: ")
    assert any(why in first for why in (" ran into something ", " Something is "))  # or it has stopped before it
    outcome = json.loads((tmp_path / "out" / "metrics.json").read_text())[run]["reached_end"]
    assert outcome["value"] == 0
    assert first.endswith(outcome["reason"])
    page = (tmp_path / "out" / "report.html").read_text()
    assert first in unescape(page.split("<h1>")[0])


def test_what_a_run_did_not_reach_is_said_before_all_else_and_is_code_1(run, tmp_path, monkeypatch):
    ended = {"seen": {"x": metric(1.0, "m"), "reached_end": outcome("base_link ran into something.")}}
    known = Experiment(LocalizationConfig, (), lambda *_: ended, dict, lambda _: "That was it.")
    monkeypatch.setattr("longreach.app.experiments.EXPERIMENTS", {"localization": known})
    monkeypatch.setattr("longreach.app.warmup.warm_up", lambda *_: None)
    answer = run("run", "localization", "--out", tmp_path / "out")
    assert answer.code == 1
    assert answer.out.splitlines()[0] == "seen did not reach its end: base_link ran into something."
    assert "That was it." in answer.out
    ended["seen"]["reached_end"] = outcome("")
    answer = run("run", "localization", "--out", tmp_path / "out")
    assert answer.code == 0
    assert "reach its end" not in answer.out


def test_of_many_runs_it_is_said_how_many_did_not_reach_their_end_and_why():
    reasons = {4: "", 5: "A wall.", 6: "", 7: "A desk."}
    found = spread({seed: {"closed": {"reached_end": outcome(reason)}} for seed, reason in reasons.items()})
    assert found == {
        "closed": {"reached_end": {"value": 0.5, "unit": "", "reason": "2 of 4 runs. Seed 5: A wall. Seed 7: A desk."}}
    }
    assert failures(found) == ["closed did not reach its end: 2 of 4 runs. Seed 5: A wall. Seed 7: A desk."]
    assert failures(spread({seed: {"closed": {"reached_end": outcome("")}} for seed in (1, 2)})) == []


# Seeds 0 and 2 raise errors: one of ours, and one that nobody expects.
_TROUBLE = """
import sys
from joblib import parallel_config
from longreach.app import localization
from longreach.cli.main import main
from longreach.errors import EstimationError

localize = localization.localize

def with_trouble(config, seed, *more):
    if seed == 0:
        raise EstimationError("The scans are empty.")
    if seed == 2:
        raise ValueError("not a number")
    return localize(config, seed, *more)

localization.localize = with_trouble
with parallel_config("threading"):  # whose workers see what was replaced
    main(sys.argv[1:])
"""


@pytest.mark.long
def test_seeds_that_raise_an_error_are_named_and_the_others_results_are_written(tmp_path):
    command = [sys.executable, "-c", _TROUBLE, "run", "localization", "--duration", "1", "--out", str(tmp_path / "out")]
    ended = subprocess.run([*command, "--seeds", "4"], capture_output=True, text=True)
    assert ended.returncode == 1, ended.stderr
    said = "2 of 4 runs. Seed 0: The scans are empty. Seed 2: ValueError: not a number."
    assert ended.stdout.splitlines()[0] == f"fused did not reach its end: {said}"
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["fused"]["reached_end"] == {"value": 0.5, "unit": "", "reason": said}
    assert metrics["fused"]["ate_rmse"]["value"] > 0.0
    page = unescape((tmp_path / "out" / "report.html").read_text())
    assert "over 2 of 4 seeds; figures show seed 1." in page
    alone = subprocess.run([*command, "--seeds", "1"], capture_output=True, text=True)
    assert alone.returncode == 2
    assert alone.stderr.strip() == "longreach: The scans are empty."


def test_the_first_seed_that_runs_is_shown_and_an_error_of_all_is_the_first_of_them():
    def run(seed):
        if seed < 6:
            raise EstimationError(f"Seed {seed} is bad.")
        return seed

    assert first_run(run, range(4, 9)) == (6, {4: "Seed 4 is bad.", 5: "Seed 5 is bad."})
    with pytest.raises(EstimationError, match=r"Seed 4 is bad\."):
        first_run(run, range(4, 6))


def test_seeds_that_fail_for_one_reason_are_given_up_after_three():
    ran = []

    def run(seed):
        ran.append(seed)
        raise EstimationError("The scans are empty.")

    with pytest.raises(EstimationError, match="The scans are empty"):
        first_run(run, range(20))
    assert ran == [0, 1, 2]


def test_what_a_failed_seed_computed_is_not_kept():
    computed = []

    class Drive:
        pass

    def run(seed):
        kept = [ref() is not None for ref in computed]
        drive = Drive()
        computed.append(weakref.ref(drive))
        if seed < 3:
            raise EstimationError(f"Seed {seed} is bad.")
        return kept

    assert first_run(run, range(5))[0] == [True, False, False]  # an error of all would be the first


def test_many_runs_give_means_and_spreads():
    runs = [{"fused": {"ate_rmse": {"value": v, "unit": "m"}, "pairs": {"value": 3, "unit": ""}}} for v in (0.1, 0.3)]
    assert spread(dict(enumerate(runs))) == {
        "fused": {
            "ate_rmse": {"value": pytest.approx(0.2), "unit": "m"},
            "ate_rmse_std": {"value": pytest.approx(0.1), "unit": "m"},
            "ate_rmse_max": {"value": 0.3, "unit": "m"},
            "pairs": {"value": 3.0, "unit": ""},
            "pairs_std": {"value": 0.0, "unit": ""},
            "pairs_max": {"value": 3.0, "unit": ""},
        }
    }
