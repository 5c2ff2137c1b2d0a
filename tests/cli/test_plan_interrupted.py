"""Ctrl-C while longreach plan is at work: nothing half-written stays behind."""

import os
import signal
import subprocess
import sys
import time

import pytest


def interrupted(tmp_path, due):
    """Run longreach plan, interrupt it when due() first holds, and return its exit code and what it printed."""
    out = tmp_path / "out"
    arguments = ["plan", "dual-trajectory", "--robot", "thing", "--method", "sqp", "--waypoints", "50", "--out", out]
    process = subprocess.Popen(
        [sys.executable, "-c", "from longreach.cli.main import main; main()", *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    end = time.monotonic() + 120.0
    while process.poll() is None and not due() and time.monotonic() < end:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    printed, _ = process.communicate(timeout=60)
    return process.returncode, printed


@pytest.mark.system
@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_an_interrupt_while_results_are_written_leaves_none(tmp_path):
    # When figures are drawn, which takes seconds. The folder itself is there a moment before it is sure to be removed.
    code, printed = interrupted(tmp_path, lambda: any(tmp_path.glob(".out.*/figures")))
    assert code == 130, printed
    assert "nothing half-written" in printed
    assert "Traceback" not in printed
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_while_planning_leaves_nothing(run, tmp_path, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("longreach.app.plan.plan", stop)
    answer = run("plan", "dual-trajectory", "--robot", "thing", "--method", "sqp", "--out", tmp_path / "out")
    assert answer.code == 130
    assert list(tmp_path.iterdir()) == []


def test_a_method_that_is_none_is_refused_before_kernels_are_compiled(run, tmp_path, monkeypatch):
    monkeypatch.setattr("longreach.app.warmup.warm_up", lambda *_: pytest.fail("compiled too early"))
    answer = run("plan", "dual-trajectory", "--robot", "thing", "--method", "sqq", "--out", tmp_path / "out")
    assert answer.code == 2
    assert "There is no method 'sqq'; there is task-priority, sqp." in answer.sentence
