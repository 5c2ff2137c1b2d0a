"""Made recordings for the tests of this room; each is made, and estimated, once."""

import pytest

from longreach.app.configuration import EstimateConfig, EvaluationConfig
from longreach.app.estimate import estimate
from longreach.io.config import load_description
from longreach.sim.kinematic import SimulationConfig, make_recording

IN_ONE_WORLD = EstimateConfig(evaluation=EvaluationConfig(align="none"))


@pytest.fixture(scope="session")
def thing():
    return load_description("thing")


@pytest.fixture(scope="session")
def made(thing):
    """10 s of driving through a room."""
    config = SimulationConfig(wheel_rate=25.0, imu_rate=50.0)
    return make_recording(thing, seed=1, duration=10.0, lidar_rate=12.5, beams=181, config=config)


@pytest.fixture(scope="session")
def estimated(made, thing):
    return estimate(made, thing, IN_ONE_WORLD)


@pytest.fixture(scope="session")
def short(thing):
    """2 s, for what only has to be taken, not taken well."""
    return make_recording(thing, duration=2.0, lidar_rate=10.0, beams=90)
