"""Calibration of real runs: Censi's tuples beside his own answers, and Polimi's bags, each judged by the other."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks/calibration.py"


@pytest.fixture(scope="module")
def benchmark():
    spec = spec_from_file_location("calibration_benchmark", BENCHMARK)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_censis_runs_keep_every_bar(data, benchmark, unchecked, capsys):
    folder = data / "calibration"
    if not folder.is_dir():
        pytest.skip(f"there is no folder {folder}")
    assert benchmark.censi(folder), capsys.readouterr().out


def test_polimis_bags_calibrate_each_other_and_the_one_that_hardly_turns_refuses_k(data, benchmark, unchecked, capsys):
    assert benchmark.polimi(data / "polimi"), capsys.readouterr().out
