"""A mount is the same as a matrix and as roll, pitch and yaw."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from longreach.robot.description import Mount
from longreach.ros.frames import mount_of

ANGLE = st.floats(-3.14, 3.14)


@given(ANGLE, st.one_of(st.floats(-1.57, 1.57), st.sampled_from([-np.pi / 2, np.pi / 2])), ANGLE)
def test_a_mount_goes_through_its_matrix_unchanged(roll, pitch, yaw):
    T = Mount(x=0.1, y=-0.2, z=0.3, roll=roll, pitch=pitch, yaw=yaw).matrix()
    np.testing.assert_allclose(mount_of(T).matrix(), T, atol=1e-8)
