"""What cameras of the simulated world see."""

from typing import Any

import numpy as np
from jaxtyping import UInt8

from longreach.errors import ConfigError
from longreach.sim.mujoco_model import engine


class Pictures:
    """MuJoCo's renderer, made when the first picture is asked for and again when its size changes."""

    def __init__(self, model: Any) -> None:
        self._model, self._renderer = model, None
        self._cameras = [model.camera(i).name for i in range(model.ncam)]

    def draw(self, data: Any, camera: str, width: int, height: int) -> UInt8[np.ndarray, "h w 3"]:
        """Return a picture (height, width, 3), RGB.

        Raises:
            ConfigError: there is no such camera, the picture is too large, or there is nothing to draw with.
        """
        if camera not in self._cameras:
            raise ConfigError(f"There is no camera {camera!r}; there are {', '.join(self._cameras)}.")
        if not (0 < width <= 1920 and 0 < height <= 1080):
            raise ConfigError(f"Pictures are up to 1920 by 1080 large, but {width} by {height} was asked for.")
        renderer: Any = self._renderer
        if renderer is None or (renderer.width, renderer.height) != (width, height):
            self.close()
            renderer = self._renderer = self._opened(width, height)
        renderer.update_scene(data, camera=camera)
        return np.array(renderer.render())

    def _opened(self, width: int, height: int) -> Any:
        mujoco = engine()
        try:
            return mujoco.Renderer(self._model, height, width)
        except Exception as error:  # whatever the graphics library raises: it is not there, or has no screen
            raise ConfigError(
                "There is nothing to draw pictures with; install EGL (libegl1 on Debian), or set MUJOCO_GL to osmesa "
                "and install OSMesa."
            ) from error

    def close(self) -> None:
        """Give the graphics library's memory back."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
