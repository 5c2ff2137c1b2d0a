import numpy as np
import pytest

from longreach.app.tool_state import tool_state
from longreach.geometry import se2, se3, so3


def mount(q):
    """A two-joint arm on a planar base, by hand: T_world_tool."""
    base = se3.from_rotation_translation(so3.exp(np.array([0, 0, q[2]])), np.array([q[0], q[1], 0.3]))
    first = se3.from_rotation_translation(so3.exp(np.array([q[3], 0, 0])), np.array([0.3, 0.0, 0.5]))
    second = se3.from_rotation_translation(so3.exp(np.array([0, q[4], 0])), np.array([0.1, 0.7, 0.2]))
    return base @ first @ second


def world_aligned_jacobian(q):
    columns, h = [], 1e-6
    for direction in np.eye(5) * h:
        a, b = mount(q - direction), mount(q + direction)
        linear = (b[:3, 3] - a[:3, 3]) / (2 * h)
        columns.append(np.concatenate([linear, so3.log(b[:3, :3] @ a[:3, :3].T) / (2 * h)]))
    return np.array(columns).T


Q = np.array([1.0, -2.0, 2.3, 0.6, -1.1])
BASE = np.array([[4e-4, 1e-4, 5e-5], [1e-4, 1e-4, -2e-5], [5e-5, -2e-5, 9e-4]])
JOINTS = np.array([[1e-4, 3e-5], [3e-5, 2e-4]])


def test_tool_covariance_is_that_of_sampled_tools(rng):
    result = tool_state(Q[:3], BASE, mount(Q), world_aligned_jacobian(Q), JOINTS)
    T = mount(Q)
    errors = []
    for _ in range(4000):
        base = se2.retract(Q[:3], np.linalg.cholesky(BASE) @ rng.standard_normal(3))
        joints = Q[3:] + np.linalg.cholesky(JOINTS) @ rng.standard_normal(2)
        errors.append(se3.difference(T, mount(np.concatenate([base, joints]))))
    sampled = np.cov(np.array(errors).T)
    scale = np.sqrt(np.diag(sampled))
    np.testing.assert_allclose(result.covariance / np.outer(scale, scale), sampled / np.outer(scale, scale), atol=0.08)


def test_exact_joints_add_nothing():
    J = world_aligned_jacobian(Q)
    exact = tool_state(Q[:3], BASE, mount(Q), J).covariance
    zero = tool_state(Q[:3], BASE, mount(Q), J, np.zeros((2, 2))).covariance
    np.testing.assert_array_equal(exact, zero)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.5, 3.0, np.pi])
def test_the_state_holds_the_tool_pose_and_the_base_pose(angle):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    T = se3.from_rotation_translation(so3.exp(angle * axis), np.array([0.1, 0.2, 0.3]))
    s = tool_state(Q[:3], BASE, T, world_aligned_jacobian(Q)).s
    np.testing.assert_array_equal(s[:3], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(s[7:], Q[:3])
    w, v = s[3], s[4:7]
    assert w >= 0.0
    assert w**2 + v @ v == pytest.approx(1.0)
    rotation = np.eye(3) + 2.0 * w * so3.hat(v) + 2.0 * so3.hat(v) @ so3.hat(v)
    np.testing.assert_allclose(rotation, T[:3, :3], atol=1e-12)
