"""Text files, compressed or not, a line at a time, with what is wrong said in one sentence."""

import bz2
import gzip
import lzma
import zlib
from collections.abc import Callable, Iterator, Sequence
from io import TextIOWrapper
from pathlib import Path

from longreach.errors import RecordingError

_OPENERS = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}


def _open(path: Path) -> TextIOWrapper:
    return _OPENERS.get(path.suffix, open)(path, "rt", encoding="utf-8-sig", errors="replace")  # type: ignore[operator]


def text_lines(path: Path, cut: Callable[[str], None] | None = None) -> Iterator[tuple[int, str]]:
    """Yield the lines that are neither empty nor a comment (#), with their numbers, from 1.

    A file whose compressed data end too early is read as far as they go where there is a `cut`, which gets a sentence.

    Raises:
        RecordingError: the file is not there, cannot be read, or its compression is broken or cut short.
    """
    try:
        with _open(path) as lines:
            for number, line in enumerate(lines, 1):
                if not line.isspace() and not line.lstrip().startswith("#"):
                    yield number, line
    except FileNotFoundError as error:
        raise RecordingError(f"{path} is not there.") from error
    except EOFError as error:
        said = f"{path} is cut short: its compressed data end too early."
        if cut is None:
            raise RecordingError(said) from error
        cut(said)
    except (gzip.BadGzipFile, zlib.error, lzma.LZMAError) as error:
        raise RecordingError(f"{path} is not what its name says: {error}.") from error
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error


def numbers(path: Path, line: int, words: Sequence[str]) -> list[float]:
    """Return the words as numbers.

    Raises:
        RecordingError: one of them is none; the sentence names the file and the line.
    """
    try:
        return [float(word) for word in words]
    except ValueError:
        wrong = next(word for word in words if not _is_number(word))
        raise RecordingError(f"{path}, line {line}: {wrong!r} is not a number.") from None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
