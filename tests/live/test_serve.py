"""Robots that are no Thing, served; and what the server says at its end."""

import re

import numpy as np
import pytest
from live_networks import until


@pytest.mark.parametrize("name", ["husky", "ur10"])
def test_a_base_without_an_arm_and_an_arm_without_a_base_are_served_and_do_what_a_client_asks_for(serve, to, name):
    served = serve("--robot", name).ready()
    client = to(served)
    bolted = client.robot.description.bolted
    before = client.state.q
    if bolted:
        goal = before + 0.1
        assert np.allclose(client.move_to(goal).q, goal, atol=0.01)
    else:

        def driven():
            client.velocity(base=np.array([0.5, 0.0, 0.0]))
            return np.hypot(*(client.state.q - before)[:2]) > 0.1

        until(driven, 20.0)
    client.close()
    output = served.end()
    assert re.search(r"A tick took \d+\.\d ms \(median\), .* at most\.", output)
    assert re.search(r"It began late by \d+\.\d ms \(median\), .* at most\.", output)
    late, ticks = map(int, re.search(r"(\d+) of (\d+) ticks were more than 1 ms late\.", output).groups())
    assert late <= ticks
    assert ticks > 20
