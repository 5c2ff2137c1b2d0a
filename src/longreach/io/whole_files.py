"""Write files whole or not at all: into a temporary neighbour first, then by rename."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from longreach.errors import LongreachError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` to write to; it takes the place of `path` when all went well."""
    with _explained(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            temporary.chmod(0o666 & ~_umask())
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `folder` to fill; its files take their places when all went well.

    Other files that are in the folder already stay.
    """
    with _explained(folder):
        check_folder(folder)
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = None
        try:
            temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
            yield temporary
            temporary.chmod(0o777 & ~_umask())
            if not folder.exists():
                os.replace(temporary, folder)
                return
            for source in sorted(p for p in temporary.rglob("*") if p.is_file()):
                target = folder / source.relative_to(temporary)
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(source, target)
        finally:
            if temporary is not None:
                shutil.rmtree(temporary, ignore_errors=True)


def check_folder(folder: Path) -> None:
    """Say before long work that its results could not be written into a folder, as far as that can be seen.

    Raises:
        LongreachError: it is a file, or nothing can be made where it should be.
    """
    if folder.exists() and not folder.is_dir():
        raise LongreachError(f"{folder} is a file; give a folder for the results.")
    check_place(folder)


def check_place(path: Path) -> None:
    """Raise a LongreachError where nothing can be made beside a path, as far as that can be seen."""
    nearest = next(parent for parent in path.absolute().parents if parent.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        raise LongreachError(f"{path} cannot be written: nothing can be made in {nearest}.")


def write_text(path: Path, text: str) -> None:
    """Write a text file as UTF-8, whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise LongreachError(f"{path} cannot be written: {error.strerror or error}.") from error
