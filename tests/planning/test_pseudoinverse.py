"""Inverses of a Jacobian: against numpy's, through singularities, and within their bounds."""

import numpy as np
import pytest
from pydantic import ValidationError

from longreach.errors import PlanningError
from longreach.planning.pseudoinverse import (
    Inverse,
    SingularValueFilter,
    damped_pseudoinverse,
    filter_singular_values,
    general_solution,
    null_space_projector,
    pseudoinverse,
    selectively_damped_step,
    singular_values,
)

SHAPES = [(1, 9), (2, 9), (3, 3), (5, 6), (6, 6), (6, 9), (9, 9), (12, 14), (12, 9)]


def of_rank(rng, m, n, values):
    """A matrix with just these singular values."""
    U, _ = np.linalg.qr(rng.normal(size=(m, m)))
    V, _ = np.linalg.qr(rng.normal(size=(n, n)))
    k = min(m, n)
    return U[:, :k] * np.resize(values, k) @ V[:, :k].T


def near_and_at_singularities(rng):
    """Jacobians of 6 x 9 with the two smallest singular values anywhere from 1 down to 0."""
    for size in [*10.0 ** -np.arange(0.0, 18.0), 0.0]:
        for _ in range(5):
            yield of_rank(rng, 6, 9, [2.0, 1.5, 1.0, 0.5, size, size * rng.uniform()])
    yield np.zeros((6, 9))
    yield np.ones((6, 9))


@pytest.mark.parametrize("shape", SHAPES)
def test_singular_values_agree_with_numpys(shape, rng):
    for values in ([3.0, 1.0, 0.3], [1.0, 1e-3, 1e-9], [1.0, 1.0, 0.0], [5.0, 5.0, 5.0]):
        J = of_rank(rng, *shape, values)
        U, s, V = singular_values(J)
        expected = np.zeros(shape[0])
        expected[: min(shape)] = np.linalg.svd(J, compute_uv=False)
        np.testing.assert_allclose(s, expected, atol=1e-13)
        np.testing.assert_allclose(U.T @ U, np.eye(shape[0]), atol=1e-13)
        np.testing.assert_allclose((U * s) @ V, J, atol=1e-13)
        k = min(shape)
        np.testing.assert_allclose(V[:k] @ V[:k].T, np.eye(k), atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_pseudoinverse_agrees_with_numpys(shape, rng):
    for values in ([3.0, 1.0, 0.3], [1.0, 1.0, 0.0]):
        J = of_rank(rng, *shape, values)
        np.testing.assert_allclose(pseudoinverse(J), np.linalg.pinv(J, rcond=1e-12), atol=1e-12)


def test_small_singular_values_keep_their_relative_precision(rng):
    J = np.diag([1.0, 1e-8, 1e-11]) @ np.linalg.qr(rng.normal(size=(5, 5)))[0][:3]
    np.testing.assert_allclose(singular_values(J)[1], [1.0, 1e-8, 1e-11], rtol=1e-12)


def test_the_projector_is_one_through_singularities(rng):
    for J in near_and_at_singularities(rng):
        N = null_space_projector(J)
        np.testing.assert_allclose(N, N.T, atol=1e-15)
        np.testing.assert_allclose(N @ N, N, atol=1e-13)
        np.testing.assert_allclose(J @ N, 0.0, atol=1e-11)
        assert np.trace(N) == pytest.approx(9 - np.linalg.matrix_rank(J, tol=1e-12 * np.linalg.norm(J, 2)))


def test_j_times_pseudoinverse_times_j_is_j_through_singularities(rng):
    for J in near_and_at_singularities(rng):
        inverse = pseudoinverse(J)
        rounding = 1e-15 * np.abs(inverse).max()  # of the product of a large and a small number
        np.testing.assert_allclose(J @ inverse @ J, J, atol=1e-11 + rounding)
        np.testing.assert_allclose(inverse @ J @ inverse, inverse, atol=1e-11 + rounding * np.abs(inverse).max())


def test_the_projector_is_the_identity_less_the_pseudoinverse_times_j(rng):
    J = rng.normal(size=(6, 9))
    np.testing.assert_allclose(null_space_projector(J), np.eye(9) - pseudoinverse(J) @ J, atol=1e-13)


def test_the_damped_inverse_is_the_formula_and_has_the_pseudoinverse_as_its_limit(rng):
    J = rng.normal(size=(6, 9))
    for damping in (1.0, 1e-2, 1e-4):
        expected = J.T @ np.linalg.inv(J @ J.T + damping * np.eye(6))  # (4.7)
        np.testing.assert_allclose(damped_pseudoinverse(J, damping), expected, atol=1e-12)
    errors = [np.abs(damped_pseudoinverse(J, 10.0**-k) - pseudoinverse(J)).max() for k in range(2, 12)]
    assert np.all(np.diff(errors) < 0)
    assert errors[-1] < 1e-9
    np.testing.assert_array_equal(damped_pseudoinverse(J, 0.0), pseudoinverse(J))


def test_a_damped_inverse_gives_no_projector_and_ours_does_not_use_it(rng):
    J = of_rank(rng, 6, 9, [1.0, 0.1])
    wrong = np.eye(9) - damped_pseudoinverse(J, 0.1) @ J
    assert np.abs(J @ wrong).max() > 1e-3
    inverse = Inverse(method="damped", damping=0.1)
    z = rng.normal(size=9)
    moved = general_solution(J, np.zeros(6), z, inverse)
    np.testing.assert_allclose(J @ moved, 0.0, atol=1e-13)
    assert np.linalg.norm(moved) > 0.1


@pytest.mark.parametrize("method", ["undamped", "damped", "selective"])
def test_z_never_disturbs_the_task(method, rng):
    inverse = Inverse(method=method, filter=SingularValueFilter())
    for J in near_and_at_singularities(rng):
        a, z = 0.01 * rng.normal(size=6), rng.normal(size=9)
        disturbed = J @ (general_solution(J, a, z, inverse) - inverse.step(J, a))
        np.testing.assert_allclose(disturbed, 0.0, atol=1e-10)


@pytest.mark.parametrize(("v", "sigma0"), [(5.0, 1e-3), (20.0, 1e-3), (20.0, 0.1), (0.0, 0.5)])
def test_filtering_lifts_zero_to_sigma0_and_keeps_the_order(v, sigma0):
    sigma = np.concatenate(([0.0], np.geomspace(1e-6, 1e3, 400)))
    lifted = np.array([filter_singular_values(np.array([[s]]), v, sigma0)[0, 0] for s in sigma])
    lifted = np.abs(lifted)
    expected = (sigma**3 + v * sigma**2 + 2 * sigma + 2 * sigma0) / (sigma**2 + v * sigma + 2)  # (4.12)
    np.testing.assert_allclose(lifted, expected, rtol=1e-12)
    assert lifted[0] == pytest.approx(sigma0)
    assert np.all(np.diff(lifted) > 0)
    assert np.all(lifted >= sigma)
    assert lifted[-1] == pytest.approx(sigma[-1], rel=1e-5)


def test_a_filtered_jacobian_is_of_full_rank_at_a_singularity(rng):
    for J in near_and_at_singularities(rng):
        lifted = np.linalg.svd(filter_singular_values(J), compute_uv=False)
        assert lifted[-1] > 0.9e-3
        np.testing.assert_allclose(filter_singular_values(J), J, atol=1.001e-3)


def test_a_filter_that_is_not_monotone_is_refused():
    with pytest.raises(ValidationError, match="at most 2"):
        SingularValueFilter(v=100.0, sigma0=0.1)


def as_buss_and_kim_write_it(J, e, bound):
    """The paper's formulas, one for one, with numpy's singular values; one bound for all joints."""

    def clamp(w, most):
        return w * min(1.0, most / max(np.abs(w).max(), 1e-300))

    U, s, V = np.linalg.svd(J, full_matrices=False)
    total = np.zeros(J.shape[1])
    for i in range(len(s)):
        if s[i] <= 1e-10:
            continue
        N = sum(np.linalg.norm(block) for block in np.split(U[:, i], len(U) // 3))
        reach = sum(np.linalg.norm(block, axis=0) for block in np.split(J, len(J) // 3))
        M = np.abs(V[i]) @ reach / s[i]
        total += clamp((U[:, i] @ e) / s[i] * V[i], bound * min(1.0, N / M))
    return clamp(total, bound)


@pytest.mark.parametrize("shape", [(3, 9), (6, 6), (6, 9), (9, 9), (12, 14)])
def test_the_selective_step_is_buss_and_kims(shape, rng):
    for scale in (1e-3, 1.0, 10.0):
        J, e = rng.normal(size=shape), scale * rng.normal(size=shape[0])
        bound = np.full(shape[1], np.pi / 4)
        np.testing.assert_allclose(
            selectively_damped_step(J, e, bound), as_buss_and_kim_write_it(J, e, np.pi / 4), atol=1e-12
        )


def test_no_selective_step_exceeds_its_bound_in_10000_jacobians(rng):
    bound = np.where(np.arange(9) < 2, 0.2, np.pi / 4)
    for k in range(10_000):
        J = rng.normal(size=(6, 9))
        if k % 4 == 1:
            J[5] = J[4] * rng.normal()  # singular
        if k % 4 == 2:
            J[3:] *= 10.0 ** rng.uniform(-12, 0)  # nearly so
        if k % 4 == 3:
            J[:, rng.integers(9)] = 0.0  # a joint that does nothing
        step = selectively_damped_step(J, 10.0 ** rng.uniform(-6, 3) * rng.normal(size=6), bound)
        assert np.all(np.abs(step) <= bound)


def test_a_small_error_far_from_singularities_is_met_by_all_methods(rng):
    J = of_rank(rng, 6, 9, [1.0, 0.8, 0.6])
    e = 1e-4 * rng.normal(size=6)
    for method in ("undamped", "damped", "selective"):
        np.testing.assert_allclose(J @ Inverse(method=method).step(J, e), e, atol=1e-9)


def test_the_error_is_clamped_block_by_block(rng):
    J = of_rank(rng, 6, 9, [1.0])
    e = np.array([3.0, 0.0, 0.0, 0.0, 0.1, 0.0])
    wide = np.full(9, np.inf)
    step = selectively_damped_step(J, e, wide, np.array([0.3, 0.5]))
    np.testing.assert_allclose(J @ step, [0.3, 0.0, 0.0, 0.0, 0.1, 0.0], atol=1e-12)


def test_prismatic_joints_have_a_bound_of_their_own(rng):
    inverse = Inverse(max_step_prismatic=0.01, max_error_linear=np.inf, max_error_angular=np.inf)
    prismatic = np.arange(9) < 2
    steps = np.array([inverse.step(rng.normal(size=(6, 9)), 5.0 * rng.normal(size=6), prismatic) for _ in range(200)])
    assert np.abs(steps[:, :2]).max() == pytest.approx(0.01)
    assert np.abs(steps[:, 2:]).max() > 0.05


def test_damping_grows_with_the_error(rng):
    J = of_rank(rng, 6, 9, [1.0, 0.1])
    e = rng.normal(size=6)
    expected = damped_pseudoinverse(J, 0.01 + 0.05 * e @ e) @ e
    np.testing.assert_allclose(Inverse(method="damped", damping=0.01).step(J, e), expected, atol=1e-12)


def test_filtering_comes_before_the_inverse(rng):
    J = of_rank(rng, 6, 9, [1.0, 0.1, 1e-3])
    e = rng.normal(size=6)
    step = Inverse(method="undamped", filter=SingularValueFilter(v=5.0)).step(J, e)
    np.testing.assert_allclose(step, pseudoinverse(filter_singular_values(J, v=5.0)) @ e, rtol=1e-9)


def test_an_inverse_comes_from_a_plain_mapping():
    inverse = Inverse.model_validate({"method": "damped", "damping": 0.1, "filter": {"v": 5, "sigma0": 0.001}})
    assert inverse.filter == SingularValueFilter(v=5.0)
    with pytest.raises(ValidationError, match="undamped"):
        Inverse.model_validate({"method": "svd"})


def test_numbers_that_are_none_are_refused():
    J = np.ones((6, 9))
    with pytest.raises(PlanningError, match="finite"):
        pseudoinverse(np.where(np.eye(6, 9) > 0, np.nan, J))
    with pytest.raises(PlanningError, match="6 finite numbers"):
        Inverse().step(J, np.array([0, 0, np.inf, 0, 0, 0]))
    with pytest.raises(PlanningError, match="positive"):
        damped_pseudoinverse(J, -1.0)
