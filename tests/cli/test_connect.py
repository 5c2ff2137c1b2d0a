"""longreach connect, with a robot that only pretends: tests/live has a real one."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest


@pytest.fixture
def sent(monkeypatch):
    """What the base was commanded. Who waits for time to pass fails."""
    sent = []

    def wait(seconds):
        raise AssertionError("it has waited")

    client = SimpleNamespace(state=SimpleNamespace(q=np.zeros(9)), velocity=lambda base=None: sent.append(base))
    monkeypatch.setattr("longreach.live.client.client.connect", lambda *_, **__: nullcontext(client))
    monkeypatch.setattr("time.sleep", wait)
    return sent


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("velocity", [[], ["--velocity", "0.2,0,0"]], ids=["watched", "driven"])
def test_no_duration_at_all_is_over_at_once(run, sent, velocity):
    answer = run("connect", "--duration", "0", *velocity)
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.strip().startswith("The robot is at [0. 0. 0.")
    assert sent == [None] * bool(velocity)  # the base is stopped, and was not driven
