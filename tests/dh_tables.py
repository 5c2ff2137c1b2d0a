"""DH tables of arms with and without a closed form, and a forward kinematics of their own, written out."""

from dataclasses import replace

import numpy as np

from longreach.robot.chain import KinematicChain
from longreach.robot.dh import rows_of

UR10 = [
    (0.1273, 0.0, 0.0, np.pi / 2),
    (0.0, 0.0, -0.612, 0.0),
    (0.0, 0.0, -0.5723, 0.0),
    (0.163941, 0.0, 0.0, np.pi / 2),
    (0.1157, 0.0, 0.0, -np.pi / 2),
    (0.0922, 0.0, 0.0, 0.0),
]
# Lengths as a real arm's calibration found them, and angles of the size that one finds.
CALIBRATED = [
    (0.12826, 1e-3, 2e-4, np.pi / 2 + 8e-4),
    (0.0, -2e-3, -0.61276, 1e-3),
    (0.001, 1e-3, -0.57167, -2e-3),
    (0.16343, 0.0, -1e-4, np.pi / 2 - 1e-3),
    (0.11568, 3e-3, 1e-4, -np.pi / 2 + 5e-4),
    (0.09205, 0.0, 0.0, 0.0),
]
PUMA = [
    (0.6, 0.0, 0.0, np.pi / 2),
    (0.0, 0.0, 0.43, 0.0),
    (0.15, 0.0, 0.02, -np.pi / 2),
    (0.43, 0.0, 0.0, np.pi / 2),
    (0.0, 0.0, 0.0, -np.pi / 2),
    (0.06, 0.0, 0.0, 0.0),
]
SLIDING = [
    (0.4, 0.0, 0.3, 0.0),
    (0.0, 0.0, 0.25, np.pi),
    (0.1, 0.0, 0.0, 0.3, "prismatic"),
    (0.0, 0.2, 0.0, 0.5),
    (0.1, 0.2, 0.1, 1.0),
    (0.1, 0.0, 0.05, -0.7),
    (0.1, 0.0, 0.0, 0.0),
]


def table_pose(rows, q):
    """The product of (3.7) over a DH table, written out."""
    T = np.eye(4)
    for (d, theta, a, alpha, *kind), x in zip(rows, q, strict=True):
        if kind:
            d = d + x
        else:
            theta = theta + x
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        A = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        T = T @ np.array(A)
    return T


def thing_pose(q):
    """The Thing's flange: its base, the arm's mount, the UR10."""
    c, s = np.cos(q[2]), np.sin(q[2])
    T_world_base = np.array([[c, -s, 0, q[0]], [s, c, 0, q[1]], [0, 0, 1, 0], [0, 0, 0, 1]])
    T_base_arm = np.array([[0, -1, 0, 0.27], [1, 0, 0, 0.01], [0, 0, 1, 0.653], [0, 0, 0, 1]])
    return T_world_base @ T_base_arm @ table_pose(UR10, q[3:])


def limited(rows, reach):
    """A table's chain with limits ±reach."""
    chain = KinematicChain.from_dh(rows_of(rows))
    reach = np.broadcast_to(np.array(reach, dtype=float), chain.dof)
    return chain.with_limits(replace(chain.limits, lower=-reach, upper=reach))
