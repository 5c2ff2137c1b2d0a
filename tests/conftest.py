"""Shared by all tests: shapes in annotations are checked at run time, randomness is seeded, real data is found."""

import os
import pkgutil
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import install_import_hook


def _checked_modules() -> list[str]:
    """Every module but the compiled kernels, whose functions numba must see undecorated."""
    spec = find_spec("longreach")
    assert spec is not None
    names = [m.name for m in pkgutil.walk_packages(spec.submodule_search_locations, "longreach.") if not m.ispkg]
    return [name for name in names if not name.endswith(("._kernels", ".kernels"))]


install_import_hook(_checked_modules(), "beartype.beartype")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real recordings, or skip."""
    folder = os.environ.get("LONGREACH_DATA")
    if not folder:
        pytest.skip("LONGREACH_DATA does not name a folder of real recordings")
    path = Path(folder).resolve()
    if not path.is_dir():
        pytest.skip(f"LONGREACH_DATA names {path}, which is not a folder")
    return path


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
