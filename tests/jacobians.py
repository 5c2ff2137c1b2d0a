"""The one finite-difference check that every Jacobian goes through."""

import numpy as np


def assert_is_jacobian(f, J, x, retract=None, difference=None, atol=1e-6, step=1e-6):
    """Check J (m, n) against central differences of f at x, on manifolds through retract and difference."""
    retract = retract or (lambda a, d: a + d)
    difference = difference or (lambda a, b: b - a)
    n = J.shape[1]
    columns = []
    for direction in np.eye(n) * step:
        forward, backward = f(retract(x, direction)), f(retract(x, -direction))
        columns.append((difference(f(x), forward) - difference(f(x), backward)) / (2 * step))
    np.testing.assert_allclose(J, np.stack(columns, axis=-1), atol=atol, rtol=1e-6)
