"""Shared by all tests: shapes in annotations are checked at run time, randomness is seeded, real data is found."""

import os
import pkgutil
from importlib.util import find_spec
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
from hypothesis import settings

pytest_plugins = ["second_try"]


def _checked_modules() -> list[str]:
    """Every module but the compiled kernels, whose functions numba must see undecorated."""
    spec = find_spec("longreach")
    assert spec is not None
    names = [m.name for m in pkgutil.walk_packages(spec.submodule_search_locations, "longreach.") if not m.ispkg]
    return [name for name in names if not name.endswith("kernels")]


jaxtyping.install_import_hook(_checked_modules(), "beartype.beartype")

# No deadline, for the first call of a kernel compiles it; the same examples on every run.
settings.register_profile("longreach", deadline=None, derandomize=True)
settings.load_profile("longreach")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shapes are not checked, as for a user: in whole runs the checks take nearly half of the time."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


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


@pytest.fixture(scope="session")
def cases(data: Path) -> Path:
    """The folder of small inputs as people report them, which stands beside that of the recordings, or skip."""
    path = data.parent / "cases"
    if not path.is_dir():
        pytest.skip(f"there is no folder {path}")
    return path


TIERS = {"live": "system", "ros": "system", "view": "system", "real": "long"}  # of whole folders


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give each test of a folder with a tier its marker, unless it has another, before pytest selects by markers."""
    for item in items:
        tier = TIERS.get(item.path.relative_to(Path(__file__).parent).parts[0])
        if tier and not any(item.get_closest_marker(name) for name in TIERS.values()):
            item.add_marker(tier)
