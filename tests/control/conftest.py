"""A small robot with two joints and a base."""

import numpy as np
import pytest
from control.recorded import NAMES

from longreach.control.hardware import Capabilities
from longreach.robot.chain import JointLimits


@pytest.fixture
def capabilities():
    limits = JointLimits(
        lower=np.array([-1.0, -0.5]),
        upper=np.array([1.0, 2.0]),
        velocity=np.array([2.0, 3.0]),
        acceleration=np.array([10.0, 5.0]),
        effort=np.array([100.0, 100.0]),
    )
    return Capabilities(NAMES, limits, np.array([1.1, 1.1, 2.0]), np.array([2.5, 2.5, 1.0]))
