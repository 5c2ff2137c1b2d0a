"""The door through which every compiled function enters: numba with a disk cache that notices edits.

numba's own cache looks only at the file of the compiled function, so an edit of a kernel that lives in another file
would go unseen. Ours lives in a folder named by a hash over the sources of all kernels: any edit starts a new folder.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import config

_MARK = "@" + "kernel"
_settings: Any = config  # its names are made at run time, out of a type checker's sight


def _sources(package: Path) -> list[Path]:
    return [path for path in sorted(package.rglob("*.py")) if _MARK in path.read_text(encoding="utf-8")]


def source_hash(package: Path) -> str:
    """Return a hash over the sources of all files below `package` that define a kernel."""
    digest = hashlib.sha256(f"numba {numba.__version__}".encode())
    for path in _sources(package):
        digest.update(path.relative_to(package).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _private_temporary() -> Path:
    """A folder that other users cannot have filled: a cache holds code that is run."""
    folder = Path(tempfile.gettempdir()) / f"longreach-{os.getuid() if hasattr(os, 'getuid') else 'cache'}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
        return Path(tempfile.mkdtemp(prefix="longreach-"))
    return folder


def _cache_root() -> Path:
    """NUMBA_CACHE_DIR if set, else the user's cache folder; where that cannot be written, the temporary folder."""
    try:
        if _settings.CACHE_DIR:
            root = Path(_settings.CACHE_DIR)
        else:
            root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "longreach"
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=root):
            return root
    except (OSError, RuntimeError):  # RuntimeError: the user has no home
        return _private_temporary()


@cache
def cache_folder() -> Path:
    """Return the folder that holds the compiled kernels of just these sources."""
    folder = _cache_root() / f"kernels-{source_hash(Path(__file__).parent)}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def kernel(
    function: Callable[..., Any] | None = None, *, fastmath: bool | set[str] = False, entry: bool = False
) -> Any:
    """Compile `function` with numba on its first call, or load it from the cache folder.

    fastmath lets the compiler reorder sums (for loops over beams); NaN and infinity must then be kept out by the
    caller. entry makes a call from Python cheaper, 0.3 instead of 0.5 µs with five arrays: for a kernel of less than a
    microsecond that makes no arrays; it keeps Python's lock.
    """
    if function is None:
        return lambda f: kernel(f, fastmath=fastmath, entry=entry)
    before = _settings.CACHE_DIR
    _settings.CACHE_DIR = str(cache_folder())  # numba picks a function's cache folder when it is decorated
    try:
        # Without the run-time for arrays (_nrt), numba does not wrap each argument in an owner of its own.
        options = {"nogil": not entry, "error_model": "numpy", "fastmath": fastmath, "_nrt": not entry}
        return numba.njit(cache=True, **options)(function)
    finally:
        _settings.CACHE_DIR = before
