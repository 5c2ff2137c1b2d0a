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
from numba.core import config as numba_config

_MARK = "@" + "kernel"


def _sources(package: Path) -> list[Path]:
    return [path for path in sorted(package.rglob("*.py")) if _MARK in path.read_text(encoding="utf-8")]


def source_hash(package: Path) -> str:
    """Return a hash over the sources of all files below `package` that define a kernel."""
    digest = hashlib.sha256(f"numba {numba.__version__}".encode())
    for path in _sources(package):
        digest.update(path.relative_to(package).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_root() -> Path:
    """NUMBA_CACHE_DIR if set, else the user's cache folder, else (read-only home) the temporary folder."""
    if numba_config.CACHE_DIR:
        return Path(numba_config.CACHE_DIR)
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "longreach"
    try:
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=root):
            return root
    except OSError:
        return Path(tempfile.gettempdir()) / f"longreach-{os.getuid() if hasattr(os, 'getuid') else 'cache'}"


@cache
def cache_folder() -> Path:
    """Return the folder that holds the compiled kernels of just these sources."""
    folder = _cache_root() / f"kernels-{source_hash(Path(__file__).parent)}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def kernel(function: Callable[..., Any] | None = None, *, fastmath: bool | set[str] = False) -> Any:
    """Compile `function` with numba on its first call, or load it from the cache folder.

    fastmath lets the compiler reorder sums (for loops over beams); NaN and infinity must then be kept out by the
    caller.
    """
    if function is None:
        return lambda f: kernel(f, fastmath=fastmath)
    before = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = str(cache_folder())  # numba picks a function's cache folder when it is decorated
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=fastmath)(function)
    finally:
        numba_config.CACHE_DIR = before
