"""Kernels and their faces against plain matrix products and finite differences, for chains of every kind of joint."""

import numpy as np
import pytest
from jacobians import assert_is_jacobian

from longreach.errors import ModelError
from longreach.geometry import se3, so3
from longreach.robot import _kinematics_kernels as kernels
from longreach.robot.chain import KinematicChain
from longreach.robot.joint import Joint


def random_chain(rng, n=7):
    """Joints of both kinds about any axes, between any transforms, some of them the ones that kernels shorten."""
    joints = []
    for i in range(n):
        origin = se3.exp(rng.normal(size=6))
        if i % 3 == 1:
            origin[:3, :3] = so3.exp(np.array([rng.normal(), 0.0, 0.0]))
        if i % 3 == 2:
            origin[:3, :3] = np.eye(3)
        axis = (0.0, 0.0, 1.0) if i % 3 else tuple(rng.normal(size=3) / 1.0)
        axis = tuple(np.array(axis) / np.linalg.norm(axis))
        kind = "prismatic" if i in (1, 3) else "revolute"
        joints.append(Joint(f"j{i}", kind, f"l{i}", f"l{i + 1}", origin, axis))
    joints.append(Joint("last", "fixed", f"l{n}", "tip", se3.exp(rng.normal(size=6))))
    return joints, KinematicChain.from_joints(joints, "l0", "tip")


def product(joints, q):
    """The chain's pose as a product of matrix exponentials."""
    T, angles = np.eye(4), iter(q)
    for joint in joints:
        T = T @ joint.origin
        if joint.kind == "prismatic":
            T = T @ se3.exp(np.array([*(np.array(joint.axis) * next(angles)), 0.0, 0.0, 0.0]))
        elif joint.kind == "revolute":
            T = T @ se3.exp(np.array([0.0, 0.0, 0.0, *(np.array(joint.axis) * next(angles))]))
    return T


def world_aligned(a, b):
    """The motion from pose a to pose b as [v; ω], world-aligned at the end."""
    return np.concatenate([b[:3, 3] - a[:3, 3], so3.log(b[:3, :3] @ a[:3, :3].T)])


@pytest.mark.parametrize("scale", [1.0, 100.0, 1e6])
def test_the_pose_is_the_product_of_the_joints(rng, scale):
    joints, chain = random_chain(rng)
    for q in rng.uniform(-1, 1, (50, 7)) * scale:
        expected = product(joints, q)
        atol = 1e-12 if scale < 1e3 else 1e-7  # there, the sliding joints are a thousand kilometres out
        np.testing.assert_allclose(chain.forward(q), expected, atol=atol)
        np.testing.assert_allclose(chain.forward_and_jacobian(q)[0], expected, atol=atol)


def test_the_jacobian_is_the_derivative_of_the_pose_for_turning_and_sliding_joints(rng):
    _, chain = random_chain(rng)
    for q in rng.uniform(-3, 3, (5, 7)):
        _, J = chain.forward_and_jacobian(q)
        assert_is_jacobian(chain.forward, J, q, difference=world_aligned)
        np.testing.assert_array_equal(J[3:, [1, 3]], 0.0)  # sliding joints do not turn
        np.testing.assert_allclose(np.linalg.norm(J[:3, [1, 3]], axis=0), 1.0, atol=1e-12)


def test_the_hessian_is_the_derivative_of_the_jacobian_for_turning_and_sliding_joints(rng):
    _, chain = random_chain(rng)
    for q in rng.uniform(-3, 3, (5, 7)):
        H = chain.hessian(q)
        flat = np.moveaxis(H, 0, -1).reshape(-1, 7)
        assert_is_jacobian(lambda x: chain.forward_and_jacobian(x)[1].ravel(), flat, q)


def test_many_configurations_give_what_single_ones_give(rng):
    _, chain = random_chain(rng)
    Q = rng.uniform(-3, 3, (4, 5, 7))
    T, J = chain.forward_and_jacobian_batch(Q.reshape(-1, 7))
    np.testing.assert_array_equal(chain.forward(Q).reshape(-1, 4, 4), T)
    for i, q in enumerate(Q.reshape(-1, 7)):
        one = chain.forward_and_jacobian(q)
        np.testing.assert_allclose(T[i], one[0], atol=1e-14)
        np.testing.assert_allclose(J[i], one[1], atol=1e-14)
    assert chain.forward(np.zeros((0, 7))).shape == (0, 4, 4)


def test_a_frame_on_the_way_has_no_columns_for_the_joints_behind_it(rng):
    joints, chain = random_chain(rng)
    middle = chain.ending("l4")
    q = rng.uniform(-3, 3, 7)
    T, J = middle.forward_and_jacobian(q)
    np.testing.assert_allclose(T, product(joints[:4], q[:4]), atol=1e-12)
    np.testing.assert_array_equal(J[:, 4:], 0.0)
    assert_is_jacobian(middle.forward, J, q, difference=world_aligned)
    flat = np.moveaxis(middle.hessian(q), 0, -1).reshape(-1, 7)
    assert_is_jacobian(lambda x: middle.forward_and_jacobian(x)[1].ravel(), flat, q)


def test_sines_and_cosines_are_right_to_rounding(rng):
    x = np.concatenate([rng.uniform(-1e5, 1e5, 2000), rng.uniform(-7, 7, 2000), np.arange(-8, 9) * np.pi / 4])
    found = np.array([kernels.sine_cosine(float(v)) for v in x])
    np.testing.assert_allclose(found, np.stack([np.sin(x), np.cos(x)], axis=1), atol=4e-16, rtol=0)


def test_given_arrays_are_filled_and_returned(rng):
    _, chain = random_chain(rng)
    q = rng.uniform(-3, 3, 7)
    T, J = np.full((4, 4), np.nan), np.full((6, 7), np.nan)
    found = chain.forward_and_jacobian(q, out=(T, J))
    assert found[0] is T
    assert found[1] is J
    fresh = chain.forward_and_jacobian(q)
    np.testing.assert_array_equal(T, fresh[0])
    np.testing.assert_array_equal(J, fresh[1])
    assert not np.shares_memory(fresh[1], chain.forward_and_jacobian(q)[1])


def test_configurations_of_any_float_type_and_layout_are_taken(rng):
    _, chain = random_chain(rng)
    q = rng.uniform(-3, 3, 7).astype(np.float32).astype(float)
    frozen = q.copy()
    frozen.flags.writeable = False
    expected = chain.forward_and_jacobian(q)[0]
    for other in (frozen, q.astype(np.float32), np.repeat(q, 2)[::2], q.astype(">f8")):
        np.testing.assert_array_equal(chain.forward_and_jacobian(other)[0], expected)


@pytest.mark.parametrize(
    ("q", "message"),
    [
        (np.zeros(6), "has 7 numbers here, but q has the shape"),
        (np.full(7, np.nan), "must be finite"),
        (np.array([0.0, 0, 0, 0, 0, 0, np.inf]), "must be finite"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_everywhere(rng, q, message):
    _, chain = random_chain(rng)
    for use in (chain.forward, chain.forward_and_jacobian, chain.hessian):
        for _ in range(2):  # the first call compiles
            with pytest.raises(ModelError, match=message):
                use(q)
    with pytest.raises(ModelError, match=message):
        chain.forward_and_jacobian_batch(q[None])


@pytest.mark.parametrize(
    "out",
    [
        (np.empty((4, 4)), np.empty((6, 6))),
        (np.empty((3, 4)), np.empty((6, 7))),
        (np.empty((4, 4)), np.empty((7, 6)).T),
        (np.empty((4, 4), dtype=np.float32), np.empty((6, 7))),
        (np.empty((4, 4)), np.broadcast_to(0.0, (6, 7))),
    ],
)
def test_arrays_that_cannot_be_filled_are_refused(rng, out):
    _, chain = random_chain(rng)
    with pytest.raises(ModelError, match="must be a writeable array of floats in C order, of the shape"):
        chain.forward_and_jacobian(np.zeros(7), out=out)
