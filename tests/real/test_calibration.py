"""Censi's tuples: our answers against his, our covariance against the scatter of sub-sets."""

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
