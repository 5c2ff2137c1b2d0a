"""The door through which every compiled function enters: numba with a disk cache that notices edits.

numba's own cache looks only at the file of the compiled function, so an edit of a kernel that lives in another file
would go unseen. Ours lies in a folder a file, named by a hash over that file and all of the package that it imports:
an edit starts a new folder for just the kernels that it can change.
"""

import hashlib
import os
import re
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import config

_IMPORT = re.compile(r"^\s*(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|[\w, ]*)|import\s+([\w.]+))", re.MULTILINE)
_PACKAGE = Path(__file__).parent
_settings: Any = config  # its names are made at run time, out of a type checker's sight


def _imported(file: Path) -> Iterator[Path]:
    """Yield the files of this package that a file imports."""
    for module, names, alone in _IMPORT.findall(file.read_text(encoding="utf-8")):
        parts = (module or alone).split(".")
        if parts[0] == _PACKAGE.name:
            place = _PACKAGE.joinpath(*parts[1:])
            inside = [place / f"{name.strip()}.py" for name in names.strip("()").split(",")]
            yield from (path for path in (place.with_suffix(".py"), *inside) if path.is_file())


@cache
def source_hash(file: Path) -> str:
    """Return a hash over a file and all files of this package that it imports, directly or not."""
    digest = hashlib.sha256(f"numba {numba.__version__}".encode())
    seen: set[Path] = set()
    waiting = [file.resolve()]
    while waiting:
        path = waiting.pop()
        if path not in seen:
            seen.add(path)
            waiting += _imported(path)
    for path in sorted(seen):
        digest.update(os.path.relpath(path, _PACKAGE).encode())
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
def cache_root() -> Path:
    """Return the folder below which all compiled kernels are kept."""
    return _cache_root()


def cache_folder(file: Path) -> Path:
    """Return the folder that holds the compiled kernels of just this version of a file; made where needed."""
    folder = cache_root() / f"{file.stem.strip('_')}-{source_hash(file)}"
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
    file = Path(function.__code__.co_filename)
    _settings.CACHE_DIR = str(cache_folder(file) if file.is_file() else cache_root())  # numba reads it when decorating
    try:
        # Without the run-time for arrays (_nrt), numba does not wrap each argument in an owner of its own.
        options = {"nogil": not entry, "error_model": "numpy", "fastmath": fastmath, "_nrt": not entry}
        return numba.njit(cache=True, **options)(function)
    finally:
        _settings.CACHE_DIR = before
