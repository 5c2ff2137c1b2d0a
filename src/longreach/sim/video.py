"""Films of a simulated robot, written without a screen: GIF, animated WebP, or animated PNG.

Not MP4: the encoders of it that Python's packages bring along are under the GPL.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from longreach.errors import ConfigError
from longreach.sim.physics import Simulation
from longreach.sim.pictures import Trail
from longreach.sim.simulated import Simulated
from longreach.sim.sketch import sketch

_FORMATS = {".gif": "GIF", ".webp": "WEBP", ".png": "PNG"}
_COLOURS = 128  # of a frame; a GIF has 256 at most


def picture(
    simulated: Simulated, trails: Sequence[Trail] = (), width: int = 640, height: int = 480
) -> UInt8[np.ndarray, "h w 3"]:
    """Return what the robot looks like now (height, width, 3), RGB, with trails in space.

    MuJoCo's picture where there are physics and something to draw with, else a sketch.
    """
    if isinstance(simulated, Simulation) and simulated.draws:
        return simulated.image("overview", width, height, trails)
    return sketch(simulated.robot, simulated.world, simulated.truth().q, trails, width, height)


@dataclass
class Film:
    """A film that is taken while a simulated robot moves: call `watch` at every tick, and `write` at the end."""

    fps: float = 10.0
    width: int = 640
    height: int = 480
    frames: list[Image.Image] = field(default_factory=list)
    due: float = 0.0

    def watch(self, simulated: Simulated, trails: Sequence[Trail] = ()) -> None:
        """Take a picture if it is time for one; trails: colour and points (n, 3) [m] of paths in space."""
        if simulated.stamp >= self.due - 1e-9:
            self.frames.append(_indexed(picture(simulated, trails, self.width, self.height)))
            self.due = max(self.due + 1.0 / self.fps, simulated.stamp + 0.5 / self.fps)

    def write(self, path: str | Path) -> None:
        """Write the film; see `write_video`."""
        _write(Path(path), self.frames, self.fps)


def write_video(path: str | Path, frames: Iterable[UInt8[np.ndarray, "h w 3"]], fps: float = 10.0) -> None:
    """Write pictures as a film that plays at their rate [Hz], over and over; the suffix says which kind.

    Raises:
        ConfigError: another suffix than .gif, .webp or .png, no pictures, or it cannot be written.
    """
    _write(Path(path), [_indexed(frame) for frame in frames], fps)


def _indexed(frame: np.ndarray) -> Image.Image:
    return Image.fromarray(frame).quantize(_COLOURS, dither=Image.Dither.NONE)


def _write(path: Path, frames: Sequence[Image.Image], fps: float) -> None:
    if path.suffix.lower() not in _FORMATS:
        raise ConfigError(f"{path} cannot be written; a film is a .gif, .webp or .png.")
    if not frames:
        raise ConfigError(f"There are no pictures for the film {path}; the run was shorter than one of them lasts.")
    kind, duration = _FORMATS[path.suffix.lower()], max(10 * round(100.0 / fps), 20)  # a GIF counts hundredths
    pictures = list(frames) if kind == "GIF" else [frame.convert("RGB") for frame in frames]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        pictures[0].save(path, kind, save_all=True, append_images=pictures[1:], duration=duration, loop=0)
    except OSError as error:
        raise ConfigError(f"The film {path} cannot be written: {error.strerror or error}.") from error
