"""The thesis' experiment with physics, driven through a server by a client: the benchmark that shows it, kept short."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks/live.py"


def test_dual_trajectory_through_a_server_has_the_tool_error_that_it_has_in_one_process():
    pytest.importorskip("mujoco", reason="physics is not installed")
    command = [sys.executable, BENCHMARK, "--dual-trajectory", "--length", "0.3", "--seeds", "1"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120.0)
    assert ended.returncode == 0, ended.stderr
    assert "waited" not in ended.stdout, ended.stdout
    through, alone = map(float, re.findall(r"([\d.]+) mm through the network, ([\d.]+) in", ended.stdout)[0])
    assert 0.01 < alone < 5.0
    assert through == pytest.approx(alone, rel=0.1)
